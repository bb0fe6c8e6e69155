"""What a source of frames is."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Protocol

from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import Frame, PixelFormat


@dataclass(frozen=True)
class Capture:
    """One frame, and what is known about it.

    Attributes
    ----------
    frame : uint8, uint16 or float32, [row, column] or [row, column, RGB]
        Integers as the sensor counts them, or as a file stores them: undoing a gamma is left to
        whoever uses the frame. Floats in linear light [0, 1].
    depth_m : float32, [row, column], optional
        True depth, NaN where unknown; of a simulator.
    sharp : float32, [row, column] or [row, column, RGB], optional
        The same view all in focus and without noise; of a simulator.
    stamp_ns : int, optional
        When it was taken, if that is known: nanoseconds of the clock of whoever took it.
    lost : float
        About how much noise lossy compression has hidden in it, in stored values from 0 to 1.
    name : str
        What to call it, and files made of it; empty where no file has it.
    mosaic : str
        Of the colour filters of a grey frame's pixels; see `grey_from_mosaic`.
    """

    frame: NDArray
    depth_m: FloatArray | None = None
    sharp: FloatArray | None = None
    stamp_ns: int | None = None
    lost: float = 0.0
    name: str = ""
    mosaic: str = ""

    def decode(self, pixel_format: PixelFormat, *, colour: bool = True) -> Frame:
        """Frame in linear light; the source's own mosaic goes before that of the format.

        Raises
        ------
        InputError
            If the pixels cannot be what the format says.
        """
        pixel_format = replace(pixel_format, mosaic=self.mosaic or pixel_format.mosaic)
        return pixel_format.frame(self.frame, self.lost, colour=colour, stamp_ns=self.stamp_ns)


class Source(Protocol):
    """Where frames come from.

    Attributes
    ----------
    live : bool
        Frames come at the source's own rate and go stale if they are not taken.
    """

    live: bool

    def read(self) -> Capture | None:
        """Return the next frame; None at the end. An `InputError` if the source fails."""

    def close(self) -> None:
        """Let go of the device or file; the next `read` begins again."""


def captures(
    source: Source, on_error: Callable[[InputError], None] | None = None
) -> Iterator[Capture]:
    """Go through the frames of a source, and close it in the end.

    A frame that cannot be read is left out if `on_error` takes the error; else that is raised.
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
