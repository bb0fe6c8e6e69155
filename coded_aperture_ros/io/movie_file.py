"""MP4 videos for display."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cv2
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output

_RATE_HZ = 10.0


@contextmanager
def movie(path: str | os.PathLike[str]) -> Iterator[Callable[[NDArray], None]]:
    """Function that adds pictures, uint8 [h, w, RGB], of one size, to a video of 10 Hz.

    The file appears when all are there. Raises `InputError` if it cannot be written, a picture has
    another size, or there is none.
    """
    with atomic_output(path) as file:
        writer = cv2.VideoWriter()
        size = (0, 0)
        count = 0

        def add(picture: NDArray) -> None:
            nonlocal size, count
            if not writer.isOpened():
                size = picture.shape[1], picture.shape[0]
                writer.open(str(file), cv2.VideoWriter.fourcc(*"mp4v"), _RATE_HZ, size)
            if not writer.isOpened():
                raise InputError(f"cannot write {path}: this OpenCV cannot write MP4 videos")
            if picture.shape[1::-1] != size:
                raise InputError(f"{path}: expected pictures of one size, give one video at a time")
            writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
            count += 1

        try:
            yield add
        finally:
            writer.release()
        if not count:
            raise InputError(f"no frame could be used: {path} was not written")
        # OpenCV does not report whether it could write.
        if cv2.VideoCapture(str(file)).get(cv2.CAP_PROP_FRAME_COUNT) != count:
            raise InputError(f"cannot write {path}: is the disk full?")
