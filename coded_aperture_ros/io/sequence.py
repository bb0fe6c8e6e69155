"""One way to go through a picture, a folder of pictures, or a video."""

import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.imaging.light import Gamma, linear_from_pixels
from coded_aperture_ros.io.picture_file import PICTURE_SUFFIXES, read_image

VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm", ".mpg", ".mpeg", ".mjpeg")


@dataclasses.dataclass(frozen=True)
class ImageSequence:
    """Named images in order; iterating reads them one by one, and may be repeated.

    Attributes
    ----------
    pictures : tuple of pathlib.Path
        The files, empty for a video.
    video : pathlib.Path or None
    gamma : float or "srgb"
        How 8-bit files and video frames are encoded.
    """

    pictures: tuple[Path, ...]
    video: Path | None = None
    gamma: Gamma = 1.0

    @property
    def length(self) -> int | None:
        """Number of images, or None for a video that does not say."""
        if self.video is None:
            return len(self.pictures)
        capture = _open_video(self.video)
        count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        capture.release()
        return count if count > 0 else None

    def __iter__(self) -> Iterator[tuple[str, NDArray[np.float32]]]:
        if self.video is not None:
            yield from self._frames(self.video)
        for path in self.pictures:
            yield path.stem, read_image(path, self.gamma)

    def _frames(self, video: Path) -> Iterator[tuple[str, NDArray[np.float32]]]:
        capture = _open_video(video)
        try:
            index = 0
            while True:
                more, frame = capture.read()
                if not more:
                    break
                rgb = cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
                yield f"{video.stem}_{index:06d}", linear_from_pixels(rgb, self.gamma)
                index += 1
        finally:
            capture.release()
        if index == 0:
            raise InputError(f"cannot read {video}: the video has no frames")


def open_sequence(path: str | os.PathLike[str], gamma: Gamma = 1.0) -> ImageSequence:
    """Open a picture, a folder of pictures (in the order of their names), or a video.

    The images are `(name, float32 linear image)`, see `read_image`; the name is the file's
    without suffix, for a video with the frame's number.

    Raises
    ------
    InputError
        Naming the path, if it is missing, a folder without pictures, or not readable.
        Reading a picture may raise it later.
    """
    path = Path(path)
    if path.is_dir():
        pictures = tuple(
            sorted(
                file
                for file in path.iterdir()
                if file.suffix.lower() in PICTURE_SUFFIXES and not file.name.startswith(".")
            )
        )
        if not pictures:
            raise InputError(f"{path}: no pictures in this folder")
        return ImageSequence(pictures, gamma=gamma)
    if not path.exists():
        raise InputError(f"cannot read {path}: no such file or folder")
    if path.suffix.lower() in VIDEO_SUFFIXES:
        _open_video(path).release()
        return ImageSequence((), video=path, gamma=gamma)
    return ImageSequence((path,), gamma=gamma)


def _open_video(path: Path) -> cv2.VideoCapture:
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise InputError(f"cannot read {path}: not a video, or no decoder for it")
    return capture
