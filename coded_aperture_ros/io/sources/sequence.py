"""Frames of a video file or a folder of pictures."""

import dataclasses
import os
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.sequence import open_sequence
from coded_aperture_ros.io.sources.source import Capture


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
        sequence = open_sequence(path)
        # One by one, so that a picture that cannot be read does not hide those after it.
        self._parts = [
            dataclasses.replace(sequence, pictures=(picture,)) for picture in sequence.pictures
        ] or [sequence]
        self._next = 0
        self._loop = loop
        self._frames: Iterator[tuple[str, NDArray[np.float32]]] | None = None
        self._ended = False

    def read(self) -> Capture | None:
        """Return the next frame, None after the last.

        After an `InputError` the next call goes on with the next picture.
        """
        while not self._ended:
            if self._frames is None:
                self._frames = iter(self._parts[self._next])
            try:
                for _, frame in self._frames:
                    return Capture(frame)
            except InputError:
                self._advance()
                raise
            self._advance()
        return None

    def _advance(self) -> None:
        self._frames = None
        self._next = (self._next + 1) % len(self._parts)
        self._ended = self._next == 0 and not self._loop

    def close(self) -> None:
        """Close the file."""
        self._frames = None
