"""Snapshots (a frame with its maps) and recordings (bags) of the viewer."""

import dataclasses
import errno
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.bags.writing import describe_write_errors
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.folders import temporary_folder
from coded_aperture_ros.depth.points import points_of_frame
from coded_aperture_ros.io import confidence_picture, depth_picture, write_depth, write_image
from coded_aperture_ros.io.messages import pixels_from_frame
from coded_aperture_ros.io.points_file import write_points
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.sources import Capture
from coded_aperture_viewer.live import Shown

_TOPIC = "/image_raw"
_INFO_TOPIC = "/camera_info"
_FRAME_ID = "camera_optical_frame"


def new_path(output: Path, kind: str) -> Path:
    """Path in `output` that does not exist yet, such as `snapshot-20260131-235959`."""
    name = f"{kind}-{time.strftime('%Y%m%d-%H%M%S')}"
    path = output / name
    number = 1
    # What another viewer is still writing has a hidden folder with this name.
    while path.exists() or any(output.glob(f".{path.name}-*")):
        number += 1
        path = output / f"{name}-{number}"
    return path


def capture_time_ns(capture: Capture) -> int:
    """Stamp of a frame, ns, or else the time of this computer."""
    return time.time_ns() if capture.stamp_ns is None else capture.stamp_ns


def write_snapshot(output: Path, shown: Shown, picture: FloatArray | None, camera: Camera) -> Path:
    """Write a frame, its maps, their pictures and its points to a new folder, or nothing.

    Parameters
    ----------
    output : Path
        Where the folder is made.
    shown : Shown
        With a frame.
    picture : ndarray or None
        What the page displays beside it.
    camera : Camera

    Returns
    -------
    Path
        The folder, which is complete when it appears.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    with describe_write_errors(output), temporary_folder(output / "snapshot") as temporary:
        written = temporary / "snapshot"
        written.mkdir()
        _write_files(written, shown, picture, camera)
        while True:
            try:
                return written.rename(new_path(output, "snapshot"))
            except OSError as error:
                # Another snapshot of this second has just got the name.
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise


def _write_files(folder: Path, shown: Shown, picture: FloatArray | None, camera: Camera) -> None:
    assert shown.frame is not None
    write_image(folder / "coded.png", shown.frame)
    if shown.sharp is not None:
        write_image(folder / "all_in_focus.png", shown.sharp)
    if picture is not None and picture is not shown.sharp:
        write_image(folder / "refocused.png", picture)
    estimate = shown.estimate
    if estimate is None or estimate.depth_m is None or estimate.std_dev_m is None:
        return
    maps = {
        "depth": estimate.depth_m,
        "std_dev": estimate.std_dev_m,
        "confidence": estimate.confidence,
    }
    maps |= {layer.spec.file_suffix[1:]: layer.values for layer in estimate.layers.values()}
    for name, values in maps.items():
        write_depth(folder / f"{name}.npy", values)
    write_image(folder / "depth.picture.png", depth_picture(estimate.depth_m))
    write_image(folder / "confidence.picture.png", confidence_picture(estimate.confidence))
    light = shown.frame if shown.sharp is None else shown.sharp
    model = camera.intrinsics if shown.capture is None else shown.capture.intrinsics(camera)
    write_points(folder / "points.ply", points_of_frame(estimate, light, model, "srgb"))


class Recording:
    """Bag of coded frames as they come from the source; `coded_aperture bag` reads it.

    Parameters
    ----------
    path : Path
        It exists after `close`.
    camera : Camera
    mosaic : str
        Colour filter array of grey frames whose source states none.

    Attributes
    ----------
    count : int
        Frames written so far.

    Raises
    ------
    InputError
        If bags cannot be written.
    """

    def __init__(self, path: Path, camera: Camera, mosaic: str) -> None:
        from coded_aperture_ros.bags import bag_output
        from coded_aperture_ros.bags.codec import CAMERA_INFO, IMAGE, camera_info_message, new_topic

        self.path = path
        self.count = 0
        self._mosaic = mosaic
        self._info = camera_info_message(camera.intrinsics)
        self._open = ExitStack()
        self._bag: Any = self._open.enter_context(bag_output(path, "mcap"))
        for topic, kind in ((_TOPIC, IMAGE), (_INFO_TOPIC, CAMERA_INFO)):
            self._bag.add_topic(new_topic(topic, kind))

    def add(self, capture: Capture) -> None:
        """Write a frame, with its stamp or else the time of this computer."""
        from coded_aperture_ros.bags.codec import camera_info_copy, camera_info_data, image_data

        time_ns = capture_time_ns(capture)
        stamp = dataclasses.replace(
            self._info.header.stamp, sec=time_ns // 10**9, nanosec=time_ns % 10**9
        )
        header = dataclasses.replace(self._info.header, stamp=stamp, frame_id=_FRAME_ID)
        pixels, encoding = _message_pixels(capture, self._mosaic)
        self._bag.write(_TOPIC, time_ns, image_data(pixels, encoding, header))
        if capture.camera_info is not None:
            info = camera_info_copy(capture.camera_info, header)
        else:
            info = camera_info_data(self._info, pixels.shape[:2], header)
        self._bag.write(_INFO_TOPIC, time_ns, info)
        self.count += 1

    def close(self) -> None:
        """Finish the bag, which gets its name only now."""
        self._open.close()


def _message_pixels(capture: Capture, mosaic: str) -> tuple[np.ndarray, str]:
    """Pixels of a frame as a message stores them, and their encoding."""
    pixels = capture.frame
    is_colour = pixels.ndim == 3
    if pixels.dtype == np.float32:
        encoding = "rgb16" if is_colour else "mono16"
        return pixels_from_frame(pixels, encoding), encoding
    bits = 8 * pixels.dtype.itemsize
    if is_colour:
        return pixels, f"rgb{bits}"
    mosaic = capture.mosaic or mosaic
    return pixels, f"bayer_{mosaic}{bits}" if mosaic else f"mono{bits}"
