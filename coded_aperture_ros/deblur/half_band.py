"""Closed-form deblurring of the lower half of the frequencies: what wide blur leaves lies there."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.inverse_filters import InverseFilters
from coded_aperture_ros.optics import PsfStack

# Frequencies that are deblurred, cycles/px: all below the first, none above the second.
_ALL_BELOW, _NONE_ABOVE = 0.17, 0.25


class HalfBandFilters(InverseFilters):
    """The filters of `InverseFilters` for the lower half of the frequencies in each direction.

    What they change in a frame of half the size is enlarged, and added to the frame. The upper
    half of the frequencies stays as it is: a PSF of more than a few pixels leaves next to nothing
    there.
    """

    reduction = 4

    def __init__(self, stack: PsfStack, rank: int, workers: Workers) -> None:
        super().__init__(stack, rank, workers)
        self._extension_px = -(-self._extension_px // 2)

    def prepare(self, shape: tuple[int, int]) -> None:
        """Compute beforehand what the first frame of `shape` (rows, columns) would wait for."""
        super().prepare((-(-shape[0] // 2), -(-shape[1] // 2)))

    def apply(
        self, channels: list[NDArray[np.float32]], places: NDArray[np.intp], noise: float
    ) -> list[NDArray[np.float32]]:
        """Deblur the channels of a frame; see `InverseFilters.apply`."""
        halves = [cv2.pyrDown(channel) for channel in channels]
        changes = super().apply(halves, places, noise)
        size = channels[0].shape[::-1]
        pairs = zip(channels, changes, strict=True)
        return [channel + cv2.pyrUp(change, dstsize=size) for channel, change in pairs]

    def _new_transforms(self, noise: float, shape: tuple[int, int]) -> NDArray[np.complex64]:
        """Return the transforms of the kernels, less the frame itself, at the lower half.

        The weights of the kernels keep the brightness of flat areas. So they give the frame back
        where each kernel is a multiple of it, and what is more is the change.
        """
        whole = self._basis(noise).transforms((2 * shape[0], 2 * shape[1]))
        rows = np.fft.fftfreq(shape[0], 1 / shape[0]).astype(np.intp)
        lower = whole[:, rows, : shape[1] // 2 + 1]
        down, across = np.fft.fftfreq(shape[0]) / 2, np.fft.rfftfreq(shape[1]) / 2
        share = _share(down)[:, None] * _share(across)
        return ((lower - lower[:, :1, :1]) * share).astype(np.complex64)


def _share(frequency: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return how much of the change is wanted, over what making smaller and larger leaves of it."""
    above = (np.abs(frequency) - _ALL_BELOW) / (_NONE_ABOVE - _ALL_BELOW)
    wanted = 0.5 + 0.5 * np.cos(np.pi * np.clip(above, 0, 1))
    # OpenCV's pyramids smooth with the binomial of five, twice.
    return np.asarray(wanted / np.cos(np.pi * frequency) ** 8)
