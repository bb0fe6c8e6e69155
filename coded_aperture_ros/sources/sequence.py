"""Frames of a video file or a folder of pictures."""

import os
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.images import open_sequence
from coded_aperture_ros.sources.source import Capture


class SequenceSource:
    """The frames of a picture, a folder of pictures or a video, once or over and over.

    Values stay as they are stored: undoing a gamma is left to whoever uses the frames.

    Parameters
    ----------
    path : path-like
    loop : bool
        Begin again after the last frame.

    Raises
    ------
    InputError
        If there is nothing to read at this path.
    """

    live = False

    def __init__(self, path: str | os.PathLike[str], loop: bool) -> None:
        self._sequence = open_sequence(path)
        self._loop = loop
        self._frames: Iterator[tuple[str, NDArray[np.float32]]] | None = None
        self._ended = False

    def read(self) -> Capture | None:
        """Return the next frame, None after the last."""
        while not self._ended:
            if self._frames is None:
                self._frames = iter(self._sequence)
            for _, frame in self._frames:
                return Capture(frame)
            self._frames = None
            self._ended = not self._loop
        return None

    def close(self) -> None:
        """Close the file."""
        self._frames = None
