"""Interface of a source of frames."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, Protocol

from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import Frame, PixelFormat, View
from coded_aperture_ros.io.messages import (
    choose_camera_info,
    region_intrinsics,
    view_from_camera_info,
)
from coded_aperture_ros.optics import Camera, Intrinsics


@dataclass(frozen=True)
class Capture:
    """Frame as a source reads it, with what the source knows about it.

    Parameters
    ----------
    frame : ndarray of uint8, uint16 or float32, [row, column] or [row, column, RGB]
        Integers as the sensor counts them, or as a file stores them, with its gamma. Floats in
        linear light [0, 1].
    depth_m : ndarray of float32 [row, column], optional
        Ground truth, m, NaN where unknown; of a simulator.
    sharp : ndarray of float32 [row, column] or [row, column, RGB], optional
        The same view all in focus and without noise; of a simulator.
    stamp_ns : int, optional
        Time of the capture, ns of the source's clock; None if unknown.
    compression_loss : float, optional
        Standard deviation of the noise that lossy compression has hidden, in stored values from 0
        to 1.
    name : str, optional
        Name for messages and output files; empty if no file has it.
    camera_info : sensor_msgs/CameraInfo, optional
        Camera model that the source has of this frame, as rclpy or rosbags has it.
    mosaic : str, optional
        Mosaic of colour filters of a grey frame's pixels; see `grey_from_mosaic`.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.frames import PixelFormat
    >>> capture = Capture(np.full((48, 64), 128, np.uint8), name="a")
    >>> capture.decode(PixelFormat()).shape
    (48, 64)
    """

    frame: NDArray
    depth_m: FloatArray | None = None
    sharp: FloatArray | None = None
    stamp_ns: int | None = None
    compression_loss: float = 0.0
    name: str = ""
    mosaic: str = ""
    camera_info: Any = None

    def decode(
        self, pixel_format: PixelFormat, camera: Camera | None = None, *, colour: bool = True
    ) -> Frame:
        """Frame in linear light, with its part of the camera's view.

        Parameters
        ----------
        pixel_format : PixelFormat
            The source's own mosaic goes before its mosaic.
        camera : Camera, optional
            Of the whole view. It tells whether the region that a driver reports is all of it.
        colour : bool, optional
            See `PixelFormat.frame`.

        Raises
        ------
        InputError
            If the pixels cannot be what the format says.
        """
        pixel_format = replace(pixel_format, mosaic=self.mosaic or pixel_format.mosaic)
        return pixel_format.frame(
            self.frame,
            self.compression_loss,
            colour=colour,
            stamp_ns=self.stamp_ns,
            view=self.view(camera),
        )

    def view(self, camera: Camera | None) -> View | None:
        """Part of the camera's view that the frame shows; None: all of it."""
        if self.camera_info is None:
            return None
        height, width = self.frame.shape[:2]
        view = view_from_camera_info(self.camera_info, width, height, camera)
        return None if view == View.whole(width, height) else view

    def intrinsics(self, camera: Camera) -> Intrinsics:
        """Pinhole model of the frame: the source's if it has one that can be, or the camera's."""
        height, width = self.frame.shape[:2]
        info, _ = choose_camera_info(self.camera_info, width, height, camera)
        if info is not None:
            return region_intrinsics(info, width, height)
        view = self.view(camera) or View.whole(width, height)
        return camera.resized(view.whole_width, view.whole_height).for_view(view).intrinsics

    def complaint(self, camera: Camera) -> str:
        """Why the source's camera model cannot be that of a camera's frame; empty if it can."""
        height, width = self.frame.shape[:2]
        return choose_camera_info(self.camera_info, width, height, camera)[1]


class Source(Protocol):
    """Source of frames.

    Attributes
    ----------
    live : bool
        Frames come at the source's own rate and go stale if they are not taken.

    Examples
    --------
    See `open_source`.
    """

    live: bool

    def read(self) -> Capture | None:
        """Next frame; None at the end. Raises `InputError` if the source fails."""

    def close(self) -> None:
        """Close the device or file; the next `read` begins again."""


def captures(
    source: Source, on_error: Callable[[InputError], None] | None = None
) -> Iterator[Capture]:
    """Frames of a source, which is closed in the end.

    A frame that cannot be read is dropped if `on_error` takes the error; else that is raised.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from coded_aperture_ros.io import write_image
    >>> from coded_aperture_ros.sources import open_files
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_image(pathlib.Path(folder, "a.png"), np.zeros((4, 6)))
    ...     [capture.name for capture in captures(open_files(folder))]
    ['a']
    """
    with closing(source):
        while True:
            try:
                capture = source.read()
            except InputError as error:
                if on_error is None:
                    raise
                on_error(error)
                continue
            if capture is None:
                return
            yield capture
