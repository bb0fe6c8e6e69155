"""Recordings as PNG files: a folder of frames, which every program of the project reads."""

from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np

from coded_aperture_ros.bags.writing import describe_write_errors
from coded_aperture_ros.core.folders import replace_folder, temporary_folder
from coded_aperture_ros.io.messages import pixels_from_frame
from coded_aperture_ros.sources import Capture
from coded_aperture_viewer.recording import capture_time_ns

# Of a file beside the frames: name and time of each.
_TIMES = "times.csv"
# The frames' thread waits for the file: the fastest level.
_COMPRESSION = (cv2.IMWRITE_PNG_COMPRESSION, 1)


class PictureRecording:
    """Folder of coded frames as they come from the source, as PNG of 8 or 16 bits.

    Parameters
    ----------
    path : Path
        It exists after `close`.

    Attributes
    ----------
    count : int
        Frames written so far.

    Raises
    ------
    InputError
        If it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.count = 0
        with ExitStack() as opened:
            opened.enter_context(describe_write_errors(path))
            self._folder = opened.enter_context(temporary_folder(path)) / path.name
            self._folder.mkdir()
            self._times = opened.enter_context((self._folder / _TIMES).open("w"))
            self._times.write("file,time_ns\n")
            self._open = opened.pop_all()

    def add(self, capture: Capture) -> None:
        """Write a frame, with its stamp or else the time of this computer."""
        name = f"frame-{self.count:06d}.png"
        with describe_write_errors(self.path):
            _write_png(self._folder / name, capture.frame)
            self._times.write(f"{name},{capture_time_ns(capture)}\n")
        self.count += 1

    def close(self) -> None:
        """Finish the folder, which gets its name only now."""
        with self._open:
            self._times.flush()
            replace_folder(self._folder, self.path)


def _write_png(path: Path, pixels: np.ndarray) -> None:
    if pixels.dtype == np.float32:
        pixels = pixels_from_frame(pixels, "rgb16" if pixels.ndim == 3 else "mono16")
    if pixels.ndim == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    path.write_bytes(cv2.imencode(".png", pixels, _COMPRESSION)[1].tobytes())
