"""Region, binning and matrices of a `sensor_msgs/CameraInfo`.

A camera model is for the whole sensor. A driver that reads a region of it (`roi`) or adds
neighbouring pixels up (`binning_x`, `binning_y`) says so there, and leaves K and P unchanged.
"""

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import View
from coded_aperture_ros.io.messages.encodings import MessageError
from coded_aperture_ros.optics.camera import Camera
from coded_aperture_ros.optics.intrinsics import Intrinsics, scaled_matrix

# Lenses differ by less from what a camera file says of them. A calibration that was scaled for
# binning once too often differs by 2 or more.
_LARGEST_FACTOR = math.sqrt(2)


def check_camera_info(info: Any) -> None:
    """Check that a camera model has no value that no camera can have.

    Parameters
    ----------
    info : sensor_msgs/CameraInfo
        Of rclpy or of rosbags. One without a calibration, whose K is 0, is not for this.

    Raises
    ------
    MessageError
        Of kind "camera_info"; see `Intrinsics`.
    """
    if not (info.width and info.height):
        reason = "width or height is 0: set the size of the pictures in the driver"
        raise MessageError("camera_info", f"camera_info: {reason}")
    try:
        sensor_intrinsics(info)
    except InputError as error:
        raise MessageError("camera_info", f"camera_info: {error}: calibrate again") from error


def choose_camera_info(info: Any, width: int, height: int, camera: Camera) -> tuple[Any, str]:
    """Camera model of a frame: the driver's, unless the camera file's has to stand in for it.

    Parameters
    ----------
    info : sensor_msgs/CameraInfo or None
        Of the driver, at the time of the frame.
    width, height : int
        Size of the frame, px.
    camera : Camera
        Of the camera file; the whole view, in any size.

    Returns
    -------
    info : sensor_msgs/CameraInfo or None
        None: the model is that of the camera file, as the driver has none, none with a calibration,
        or one that is refused.
    complaint : str
        Why the driver's is refused; empty if it is not. See `contradiction`.
    """
    if info is None:
        return None, ""
    complaint = contradiction(info, width, height, camera)
    return (None if complaint or not has_matrices(info) else info), complaint


def contradiction(info: Any, width: int, height: int, camera: Camera) -> str:
    """Why a model cannot be that of a camera's frames of this size; empty if it can.

    Parameters
    ----------
    info : sensor_msgs/CameraInfo
    width, height : int
        Size of the frames, px.
    camera : Camera
        Of the whole view, in any size.
    """
    if view_from_camera_info(info, width, height, camera) is None:
        size = f"{info.roi.width or info.width}x{info.roi.height or info.height}"
        return (
            f"camera_info is for {size}, which does not have the proportions "
            f"of the {width}x{height} frames"
        )
    if not has_matrices(info):
        return ""
    of_region, of_whole = _focal_factors(info, width, height, camera)
    if min(of_region, of_whole) <= math.log(_LARGEST_FACTOR):
        return ""
    whole_px = camera.focal_length_px * info.width / camera.image_width
    return (
        f"camera_info has a focal length of {info.k[0]:g} px, the camera file {whole_px:g} px in a "
        "view of this width: calibrate in pixels of the whole sensor, or correct the camera file"
    )


def has_matrices(info: Any) -> bool:
    """Whether a message has a calibration: without one K is 0."""
    return bool(info.k[0])


def without_matrices(info: Any) -> Any:
    """Region and binning of a message, without its calibration."""
    region = {name: getattr(info, name) for name in ("width", "height", "binning_x", "binning_y")}
    return SimpleNamespace(**region, roi=info.roi, k=(0.0,) * 9, header=info.header)


def view_from_camera_info(info: Any, width: int, height: int, camera: Camera | None) -> View | None:
    """View of a frame of this size in a camera's whole view; None if it cannot be a part of it.

    A frame of another size than binning gives is taken to be the region resized. Where the focal
    length of the message is that of a camera file for frames of the region, not for those of the
    whole sensor, the region is all of the file's view; such a file has the size of these frames.
    """
    left, top, columns, rows = _region(info)
    x = _scale(width, columns, info.binning_x)
    y = _scale(height, rows, info.binning_y)
    inside = 0 < left + columns <= info.width and 0 < top + rows <= info.height
    if not inside or abs(rows * x - height) > 1.0:
        return None
    if camera is not None and _is_all(info, width, height, camera):
        return View.whole(width, height)
    whole = int(info.width * x + 1e-6), int(info.height * y + 1e-6)
    return View(width, height, *whole, left * x, top * y, max(info.binning_x, info.binning_y) > 1)


def _is_all(info: Any, width: int, height: int, camera: Camera) -> bool:
    """Whether a region is all of the view that a camera file is for."""
    if has_matrices(info):
        of_region, of_whole = _focal_factors(info, width, height, camera)
        return of_region < of_whole
    return _is_for_region(info, width, height, camera)


def _is_for_region(info: Any, width: int, height: int, camera: Camera) -> bool:
    """Whether a camera file has the size of a region's frames, and not that of the sensor."""
    size = camera.image_width, camera.image_height
    return size in ((width, height), _region(info)[2:]) and size != (info.width, info.height)


def _focal_factors(info: Any, width: int, height: int, camera: Camera) -> tuple[float, float]:
    """Logarithms of how many times K's focal length is that of a camera file, without sign.

    The first is for a file of the region's frames, infinite if it cannot be one; the second for one
    of the whole sensor.
    """
    columns = _region(info)[2]
    angle = camera.focal_length_px / camera.image_width
    of_region, of_whole = (abs(math.log(info.k[0] / (angle * n))) for n in (columns, info.width))
    if not _is_for_region(info, width, height, camera):
        of_region = math.inf
    return of_region, of_whole


def sensor_intrinsics(info: Any, camera_name: str = "camera") -> Intrinsics:
    """Intrinsics of the whole sensor in a message, whatever region and binning it states.

    Raises
    ------
    InputError
        If it has a value that no camera can have.
    """
    model = Intrinsics(
        image_width=int(info.width),
        image_height=int(info.height),
        camera_matrix=tuple(map(float, info.k)),
        distortion_coefficients=tuple(map(float, info.d)),
        distortion_model=info.distortion_model,
        rectification_matrix=tuple(map(float, info.r)),
        projection_matrix=tuple(map(float, info.p)) if any(info.p) else (),
        camera_name=camera_name,
    )
    model.check_measured()
    return model


def region_matrices(info: Any, width: int, height: int) -> tuple[list[float], list[float]]:
    """K and P of the region of a `sensor_msgs/CameraInfo`, in frames of `width` x `height`.

    `info` needs the fields `width`, `height`, `roi`, `k` and `p`; P is made from K where a driver
    left it empty. Distortion coefficients act on normalised coordinates and stay. Raises
    `MessageError` of kind "camera_info" if the message has no camera model.
    """
    if info.width == 0 or info.height == 0 or info.k[0] <= 0 or info.k[4] <= 0:
        raise MessageError("camera_info", "camera_info holds no camera model (size or K is 0)")
    left, top, columns, rows = _region(info)
    x = width / columns
    y = height / rows
    k = list(scaled_matrix(info.k, x, y, left, top))
    if info.p[0] > 0:
        return k, list(scaled_matrix(info.p, x, y, left, top))
    return k, [*k[:3], 0.0, *k[3:6], 0.0, 0.0, 0.0, 1.0, 0.0]


def region_intrinsics(info: Any, width: int, height: int) -> Intrinsics:
    """Intrinsics of the region of a message, in frames of a size.

    Raises what `sensor_intrinsics` and `region_matrices` do.
    """
    k, p = region_matrices(info, width, height)
    return dataclasses.replace(
        sensor_intrinsics(info),
        image_width=width,
        image_height=height,
        camera_matrix=tuple(k),
        projection_matrix=tuple(p),
    )


def _region(info: Any) -> tuple[int, int, int, int]:
    """Left, top, width and height of the region of interest; a size of 0 stands for all."""
    roi = info.roi
    left, columns = (roi.x_offset, roi.width) if roi.width else (0, info.width)
    top, rows = (roi.y_offset, roi.height) if roi.height else (0, info.height)
    return left, top, columns, rows


def _scale(pixels: int, length: int, binning: int) -> float:
    """Pixels of the frame per pixel of the sensor."""
    binned = max(binning, 1)
    return 1 / binned if pixels == length // binned else pixels / max(length, 1)
