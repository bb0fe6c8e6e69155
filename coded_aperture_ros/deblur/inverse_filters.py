"""Closed-form deblurring: each pixel filtered by the inverse of its own level's PSF."""

from functools import cache, lru_cache
from typing import Generic, TypeVar

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray, IndexArray, Shape
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.blur_map import local_variance
from coded_aperture_ros.deblur.inverse_basis import MODEL_ERRORS, InverseBasis
from coded_aperture_ros.frames import extend_periodically, periodic_shape
from coded_aperture_ros.optics import PsfStack

# How finely maps are looked up between levels.
STEPS_PER_LEVEL = 8
# The error that a change of blur size within reach of the filters makes, per pixel of its standard
# deviation; from the best choice on ray-traced scenes.
_ERROR_PER_PX = 0.03
# How far the surroundings matter, in px of the frame: about the largest blur, where filters reach
# strongest.
_SURROUNDINGS_PX = 42
# Frames are extended by this, or by the width of the PSFs, before they are filtered. Twice as much
# gains 0.2 dB near the border.
_EXTENSION_PX = 32
# There is a basis for each of these noises; the nearest one is used.
_NOISES = (0.001, 0.003, 0.01, 0.03)
# Frequencies that `HalfBandFilters` deblur, cycles/px: all below the first, none above the second.
_PASS_BELOW = 0.17
_STOP_ABOVE = 0.25
# Colour differences have less texture than brightness, but as much noise: they are deblurred as if
# they had so many times more, and by half as many kernels.
COLOUR_NOISE = 2.0


class InverseFilters:
    """Space-varying deblurring in closed form.

    The inverse filters of all levels share a basis of a few kernels. A frame is filtered by the
    kernels, and every pixel takes the combination for its own blur size: the time does not depend
    on the number of levels or on the relief of the scene. The basis has `rank` kernels at most.
    """

    # Weights change slowly: their map has so many times fewer rows and columns.
    reduction = 2
    # Model errors for which there are filters, and how finely maps are looked up between them.
    model_errors = np.geomspace(MODEL_ERRORS[0], MODEL_ERRORS[-1], 4)
    steps_per_error = 4

    def __init__(self, stack: PsfStack, rank: int, workers: Workers) -> None:
        self._stack = stack
        self._workers = workers
        # A PSF reaches so far across the passage from one border to the other, and no farther.
        self._extension_px = max(_EXTENSION_PX, stack.psfs.shape[-1] - 1)
        self._order = np.argsort(stack.blur_sizes_px)
        self._basis = cache(lambda noise: InverseBasis.learn(stack, noise, rank))
        self._transforms = lru_cache(maxsize=len(_NOISES))(self._new_transforms)
        self._lookup_table = lru_cache(maxsize=32)(self._new_lookup_table)

    def prepare(self, shape: Shape) -> None:
        """Make the filters for frames of `shape` (rows, columns) before the first one."""
        for noise in _NOISES[:-1]:
            self._transforms(noise, periodic_shape(shape, self._extension_px))

    def table_indices(self, blur: FloatArray) -> IndexArray:
        """Index of each pixel in the tables of coefficients, of any rank and noise.

        `blur` has signed blur sizes in px of the frame [rows / reduction, columns / reduction].
        """
        least = float(self.model_errors[0])
        log_error = _log_model_error(blur, self.reduction, least)
        error = _fractional_index(np.log(self.model_errors), log_error)
        place = self.table_steps(blur).astype(np.float32)
        place *= self.steps_per_error * (len(self.model_errors) - 1) + 1
        place += np.rint(error * self.steps_per_error)
        return place.astype(np.intp)

    def table_steps(self, blur: FloatArray) -> IndexArray:
        """Step of each signed blur size among those of the tables."""
        level = _fractional_index(self._stack.blur_sizes_px[self._order], blur)
        return np.rint(level * STEPS_PER_LEVEL).astype(np.int32)

    def apply(
        self, channels: list[FloatArray], table_indices: IndexArray, noise: float
    ) -> list[FloatArray]:
        """Deblurred channels of a frame; `noise` is its standard deviation, > 0."""
        shape = channels[0].shape
        transforms, lookup = self._filters(shape, noise)
        weights = [np.empty(0, np.float32)] * len(lookup)  # of every kernel in every pixel

        def weigh(kernel: int, _: int) -> None:
            weights[kernel] = cv2.resize(np.take(lookup[kernel], table_indices), shape[::-1])

        self._workers.each(weigh, range(len(lookup)))
        return [self._filter(channel, transforms, weights) for channel in channels]

    def _filters(
        self, shape: tuple[int, ...], noise: float
    ) -> tuple[NDArray[np.complex64], FloatArray]:
        """Kernels' transforms for images of a shape, and the table of coefficients."""
        basis_noise = min(_NOISES, key=lambda known: abs(np.log(known / noise)))
        periodic = periodic_shape((shape[0], shape[1]), self._extension_px)
        # Steps of a tenth of a decade: there are few different tables.
        table = self._lookup_table(basis_noise, round(10 * np.log10(noise)))
        return self._transforms(basis_noise, periodic), table

    def _filter(
        self, channel: FloatArray, transforms: NDArray[np.complex64], weights: list[FloatArray]
    ) -> FloatArray:
        height, width = channel.shape
        shape = periodic_shape(channel.shape, self._extension_px)
        spectrum = scipy.fft.rfft2(
            extend_periodically(channel, shape), workers=self._workers.threads
        )
        sums = [np.zeros_like(channel) for _ in range(self._workers.threads)]

        def add(kernel: int, thread: int) -> None:
            filtered = scipy.fft.irfft2(spectrum * transforms[kernel], shape, overwrite_x=True)
            cv2.accumulateProduct(filtered[:height, :width], weights[kernel], sums[thread])

        self._workers.each(add, range(len(weights)), sums=True)
        return np.sum(sums, axis=0) if len(sums) > 1 else sums[0]

    def _new_transforms(self, noise: float, shape: Shape) -> NDArray[np.complex64]:
        return self._basis(noise).transforms(shape)

    def _new_lookup_table(self, basis_noise: float, tenths: int) -> FloatArray:
        """Interpolated coefficients [R, steps of level * steps of model error]."""
        table = self._basis(basis_noise).coefficients(self.model_errors, 10 ** (tenths / 10))
        table = table[self._order]
        for axis, steps in ((0, STEPS_PER_LEVEL), (1, self.steps_per_error)):
            table = np.moveaxis(table, axis, 0)
            position = np.arange(steps * (len(table) - 1) + 1) / steps
            lower = np.minimum(position.astype(np.intp), len(table) - 2)
            above = (position - lower).astype(np.float32)[:, None, None]
            table = np.moveaxis(table[lower] * (1 - above) + table[lower + 1] * above, 0, axis)
        return np.ascontiguousarray(table.reshape(-1, table.shape[-1]).T)


def _fractional_index(grid: NDArray[np.floating], values: FloatArray) -> NDArray[np.floating]:
    """Fractional indices of values in an ascending grid, those beyond at the ends."""
    last = len(grid) - 1
    steps = np.diff(grid)
    if last == 0 or not steps[0] or np.ptp(steps) > 1e-6 * np.abs(steps).mean():
        return np.interp(values, grid, np.arange(last + 1))
    # Equally spaced, as they usually are: several times as fast.
    first = np.float32(grid[0])
    step = np.float32((grid[-1] - grid[0]) / last)
    return np.clip((values - first) / step, 0, np.float32(last))


def _log_model_error(blur: FloatArray, reduction: int, least: float) -> FloatArray:
    """Logarithm of each pixel's model error, from the change of the blur size around it."""
    variance = local_variance(blur, _SURROUNDINGS_PX // reduction | 1)
    variance *= np.float32(_ERROR_PER_PX**2)
    variance += np.float32(least**2)
    return np.asarray(np.log(variance) / 2, np.float32)


class HalfBandFilters(InverseFilters):
    """`InverseFilters` for the lower half of the frequencies in each direction.

    The change of a frame of half the size is enlarged, and added to the frame. The upper half of
    the frequencies stays: a PSF of more than a few pixels leaves next to nothing there.
    """

    reduction = 4

    def __init__(self, stack: PsfStack, rank: int, workers: Workers) -> None:
        super().__init__(stack, rank, workers)
        self._extension_px = -(-self._extension_px // 2)

    def prepare(self, shape: Shape) -> None:
        """Make the filters for frames of `shape` (rows, columns) before the first one."""
        super().prepare((-(-shape[0] // 2), -(-shape[1] // 2)))

    def apply(
        self, channels: list[FloatArray], table_indices: IndexArray, noise: float
    ) -> list[FloatArray]:
        """Deblurred channels of a frame; see `InverseFilters.apply`."""
        halves = [cv2.pyrDown(channel) for channel in channels]
        changes = super().apply(halves, table_indices, noise)
        size = channels[0].shape[::-1]
        pairs = zip(channels, changes, strict=True)
        return [channel + cv2.pyrUp(change, dstsize=size) for channel, change in pairs]

    def _new_transforms(self, noise: float, shape: Shape) -> NDArray[np.complex64]:
        """Transforms of the kernels, less the frame itself, at the lower half.

        The weights of the kernels keep the brightness of flat areas. So they give the frame back
        where each kernel is a multiple of it, and the rest is the change.
        """
        whole = self._basis(noise).transforms((2 * shape[0], 2 * shape[1]))
        rows = np.fft.fftfreq(shape[0], 1 / shape[0]).astype(np.intp)
        lower = whole[:, rows, : shape[1] // 2 + 1]
        down = np.fft.fftfreq(shape[0]) / 2
        across = np.fft.rfftfreq(shape[1]) / 2
        share = _band_gain(down)[:, None] * _band_gain(across)
        return ((lower - lower[:, :1, :1]) * share).astype(np.complex64)


def _band_gain(frequency: NDArray[np.floating]) -> NDArray[np.floating]:
    """Wanted share of the change, over the share that resampling leaves."""
    above = (np.abs(frequency) - _PASS_BELOW) / (_STOP_ABOVE - _PASS_BELOW)
    wanted = 0.5 + 0.5 * np.cos(np.pi * np.clip(above, 0, 1))
    # OpenCV's pyramids smooth with the binomial of five, twice.
    return np.asarray(wanted / np.cos(np.pi * frequency) ** 8)


Filters = TypeVar("Filters", bound=InverseFilters)


class OpponentFilters(Generic[Filters]):
    """Filters of a camera for brightness, and for colour differences."""

    def __init__(self, make: type[Filters], stack: PsfStack, rank: int, workers: Workers) -> None:
        self._brightness = make(stack, rank, workers)
        self._colour = make(stack, max(rank // 2, 2), workers)

    def prepare(self, shape: Shape) -> None:
        """Make the filters for frames of `shape` (rows, columns) before the first one."""
        self._brightness.prepare(shape)
        self._colour.prepare(shape)
