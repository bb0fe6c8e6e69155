"""Frames of pictures, videos and other files, once or in a loop."""

from abc import ABC, abstractmethod
from collections.abc import Generator
from pathlib import Path
from typing import Generic, TypeVar

import cv2
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.picture_file import read_compressed
from coded_aperture_ros.sources.source import Capture

VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm", ".mpg", ".mpeg", ".mjpeg")

# Codes of lossless codecs, and noise that the others hide at usual rates, in stored values.
_LOSSLESS = (b"FFV1", b"HFYU", b"FFVH", b"LAGS", b"\0\0\0\0", b"DIB ", b"RAW ", b"I420", b"PNG ")
_VIDEO_LOSS = 0.009

Stored = TypeVar("Stored")


class FileSource(ABC, Generic[Stored]):
    """Frames of files, one after the other; with `loop` they begin again after the last one.

    After an `InputError`, for a frame that cannot be used, the next `read` continues behind it.

    Attributes
    ----------
    length : int or None
        Number of frames, if it is known.
    damage : str
        Description of a fault of the files; empty if there is none, or none was met yet.
    """

    live = False
    damage = ""

    def __init__(self, files: tuple[Path, ...], length: int | None, loop: bool) -> None:
        self.files = files
        self.length = length
        self._loop = loop
        self._row: Generator[Stored, None, None] | None = None

    def read(self) -> Capture | None:
        """Next frame, None after the last."""
        stored = self._next()
        if stored is None and self._loop:
            self._row = None
            stored = self._next()
        return None if stored is None else self._capture(stored)

    def close(self) -> None:
        """Close the files; the next `read` opens them again and begins with the first frame."""
        if self._row is not None:
            self._row.close()
        self._row = None

    def _next(self) -> Stored | None:
        if self._row is None:
            self._row = self._stored()
        return next(self._row, None)

    @abstractmethod
    def _stored(self) -> Generator[Stored, None, None]:
        """Frames as the files have them."""

    @abstractmethod
    def _capture(self, stored: Stored) -> Capture:
        """Frame; raises `InputError` if it cannot be used."""


class PictureSource(FileSource[Path]):
    """Frames of one or more pictures.

    Examples
    --------
    See `captures`.
    """

    def __init__(self, files: tuple[Path, ...], loop: bool = False) -> None:
        super().__init__(files, len(files), loop)

    def _stored(self) -> Generator[Path, None, None]:
        yield from self.files

    def _capture(self, stored: Path) -> Capture:
        pixels, loss = read_compressed(stored)
        return Capture(pixels, compression_loss=loss, name=stored.stem)


class VideoSource(FileSource[Capture]):
    """Frames of a video; raises `InputError` if it is none, or there is no decoder for it."""

    def __init__(self, path: Path, loop: bool = False) -> None:
        video = _open_video(path)
        count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        video.release()
        super().__init__((path,), count if count > 0 else None, loop)

    def _stored(self) -> Generator[Capture, None, None]:
        (path,) = self.files
        video = _open_video(path)
        index = 0
        code = int(video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little")
        loss = 0.0 if code.upper() in _LOSSLESS else _VIDEO_LOSS
        try:
            while (frame := _frame(video)) is not None:
                yield Capture(frame, compression_loss=loss, name=f"{path.stem}_{index:06d}")
                index += 1
        finally:
            video.release()
        if index == 0:
            raise InputError(f"cannot read {path}: the video has no frames")

    def _capture(self, stored: Capture) -> Capture:
        return stored


def _open_video(path: Path) -> cv2.VideoCapture:
    video = cv2.VideoCapture(str(path))
    if not video.isOpened():
        raise InputError(f"cannot read {path}: not a video, or no decoder for it")
    # As the sensor saw it: turned upright, a frame would no longer suit the mask.
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return video


def _frame(video: cv2.VideoCapture) -> NDArray | None:
    more, frame = video.read()
    return cv2.cvtColor(frame, cv2.COLOR_BGR2RGB) if more else None
