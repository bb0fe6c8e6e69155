"""Region, binning and matrices of a `sensor_msgs/CameraInfo`.

A camera model is for the whole sensor. A driver that reads a region of it (`roi`) or adds
neighbouring pixels up (`binning_x`, `binning_y`) says so there, and leaves K and P unchanged.
"""

import math
from typing import Any

from coded_aperture_ros.frames import View
from coded_aperture_ros.io.messages.encodings import MessageError
from coded_aperture_ros.optics.camera import Camera
from coded_aperture_ros.optics.intrinsics import scaled_matrix


def view_from_camera_info(info: Any, width: int, height: int, camera: Camera) -> View | None:
    """View of a frame of this size in a camera's whole view; None if it cannot be a part of it.

    A frame of another size than binning gives is taken to be the region resized. Where the focal
    length of the message is that of a camera file for frames of the region, not for those of the
    whole sensor, the region is all of the file's view.
    """
    left, top, columns, rows = _region(info)
    x = _scale(width, columns, info.binning_x)
    y = _scale(height, rows, info.binning_y)
    inside = 0 < left + columns <= info.width and 0 < top + rows <= info.height
    if not inside or min(info.k[0], info.k[4]) <= 0 or abs(rows * x - height) > 1.0:
        return None
    whole = int(info.width * x + 1e-6), int(info.height * y + 1e-6)
    angle = camera.focal_length_px / camera.image_width
    frame_error, whole_error = (
        abs(math.log(info.k[0] * x / (angle * n))) for n in (width, whole[0])
    )
    if frame_error < whole_error:
        return View.whole(width, height)
    return View(width, height, *whole, left * x, top * y, max(info.binning_x, info.binning_y) > 1)


def scaled_matrices(info: Any, width: int, height: int) -> tuple[list[float], list[float]]:
    """K and P of a `sensor_msgs/CameraInfo` for its region at `width` x `height`.

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
