"""Closed-form deblurring of the lower half of the frequencies: what wide blur leaves lies there."""

from functools import lru_cache

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.deblur.fast import InverseFilters
from coded_aperture_ros.engine import Workers
from coded_aperture_ros.optics import PsfStack

# Frequencies that are deblurred, cycles/px: all below the first, none above the second.
_ALL_BELOW, _NONE_ABOVE = 0.17, 0.25
# Sides of what is transformed, px: fast, and even at half the size.
_MULTIPLE = 16


class HalfBandFilters(InverseFilters):
    """The filters of `InverseFilters` for the lower half of the frequencies in each direction.

    A quarter of the samples tells them. The upper half stays as it is: a PSF of more than a few
    pixels leaves next to nothing there.

    Parameters
    ----------
    stack : PsfStack
    rank : int
    workers : Workers
        See `InverseFilters`. Only the calling thread works.
    """

    def __init__(self, stack: PsfStack, rank: int, workers: Workers) -> None:
        super().__init__(stack, rank, workers)
        self._margin_px += self._margin_px % 2
        self._transforms = lru_cache(maxsize=4)(self._new_transforms)
        self._passes = lru_cache(maxsize=4)(_passes)

    def _weights(
        self, lookup: NDArray[np.float32], places: NDArray[np.intp], size: tuple[int, int]
    ) -> list[NDArray[np.float32]]:
        """Return the weights at half the size of the padded frame."""
        shape, margin = self._padded_shape(size), self._margin_px // 2
        below, right = (
            full // 2 - part - margin for full, part in zip(shape, places.shape, strict=True)
        )
        # OpenCV has no maps of 64-bit integers.
        around = cv2.copyMakeBorder(
            places.astype(np.int32), margin, below, margin, right, cv2.BORDER_REPLICATE
        )
        return [np.take(table, around) for table in lookup]

    def _filter(
        self,
        channel: NDArray[np.float32],
        transforms: NDArray[np.complex64],
        weights: list[NDArray[np.float32]],
    ) -> NDArray[np.float32]:
        spectrum = scipy.fft.rfft2(self._padded(channel))
        shape = self._padded_shape(channel.shape)
        half, (rows, columns) = (shape[0] // 2, shape[1] // 2), _low_part(shape)
        low = np.concatenate([spectrum[:rows, :columns], spectrum[-rows:, :columns]])
        total = np.zeros(half, np.float32)
        for transform, weight in zip(transforms, weights, strict=True):
            part = scipy.fft.irfft2(low * transform, half, overwrite_x=True)
            cv2.accumulateProduct(part, weight, total)
        deblurred = scipy.fft.rfft2(total)
        spectrum *= self._passes(shape)
        spectrum[:rows, :columns] += deblurred[:rows]
        spectrum[-rows:, :columns] += deblurred[-rows:]
        sharp = scipy.fft.irfft2(spectrum, shape, overwrite_x=True)
        return np.ascontiguousarray(sharp[self._inside(channel.shape)])

    def _padded_shape(self, shape: tuple[int, ...]) -> tuple[int, int]:
        margins = 2 * self._margin_px
        height, width = (
            _MULTIPLE * scipy.fft.next_fast_len(-(-(side + margins) // _MULTIPLE), real=True)
            for side in shape[:2]
        )
        return height, width

    def _new_transforms(self, noise: float, shape: tuple[int, int]) -> NDArray[np.complex64]:
        """Return the transforms of the kernels at the lower half of the frequencies."""
        transforms = self._basis(noise).transforms(shape) * (1 - self._passes(shape))
        rows, columns = _low_part(shape)
        parts = [transforms[:, :rows, :columns], transforms[:, -rows:, :columns]]
        return np.ascontiguousarray(np.concatenate(parts, axis=1))


def _low_part(shape: tuple[int, int]) -> tuple[int, int]:
    """Return how many rows at either end, and columns, of a transform half the frequencies are.

    They are the transform of a frame of half the size. Its scale of a quarter cancels on the way
    back.
    """
    return shape[0] // 4, shape[1] // 4 + 1


def _passes(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return the share of every frequency that stays as it is."""

    def deblurred(frequency: NDArray[np.floating]) -> NDArray[np.floating]:
        above = (np.abs(frequency) - _ALL_BELOW) / (_NONE_ABOVE - _ALL_BELOW)
        return np.asarray(0.5 + 0.5 * np.cos(np.pi * np.clip(above, 0, 1)))

    rows, columns = np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1])
    share = deblurred(rows)[:, None] * deblurred(columns)
    return (1 - share).astype(np.float32)
