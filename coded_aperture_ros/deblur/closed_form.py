"""The closed form for brightness and colour: what `fast` is, and what the others begin with."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.half_band import HalfBandFilters
from coded_aperture_ros.deblur.inverse_filters import InverseFilters
from coded_aperture_ros.optics import PsfStack

# Colour differences have less texture than brightness, but as much noise: they are deblurred as if
# they had so many times more, and by half as many kernels.
_COLOUR_NOISE = 2.0


class ClosedForm:
    """The inverse filters of a camera.

    Parameters
    ----------
    stack : PsfStack
    rank : int
        Kernels for brightness.
    band : {"full", "half"}
        Frequencies that are deblurred.
    workers : Workers

    Attributes
    ----------
    reduction : int
        How many times smaller than the frame its map of blur sizes is.
    """

    def __init__(self, stack: PsfStack, rank: int, band: str, workers: Workers) -> None:
        filters = HalfBandFilters if band == "half" else InverseFilters
        self._of_brightness = filters(stack, rank, workers)
        self._of_colour = filters(stack, max(rank // 2, 2), workers)
        self.reduction = filters.reduction

    def prepare(self, shape: tuple[int, int]) -> None:
        """Compute beforehand what the first frame of `shape` (rows, columns) would wait for."""
        self._of_brightness.prepare(shape)
        self._of_colour.prepare(shape)

    def restore(
        self, channels: list[NDArray[np.float32]], blur_size_px: NDArray[np.float32], noise: float
    ) -> list[NDArray[np.float32]]:
        """Deblur the `opponents` of a frame, by a map that is smaller by `reduction`."""
        places = self._of_brightness.places(blur_size_px)
        restored = self._of_brightness.apply(channels[:1], places, noise)
        if len(channels) > 1:
            restored += self._of_colour.apply(channels[1:], places, _COLOUR_NOISE * noise)
        return restored
