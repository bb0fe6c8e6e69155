"""Which side of the focal plane the scene is on, from the phase of its spectrum (thesis 9.3).

A power spectrum is the same before and behind the focal plane, where the PSF is the mask and the
mask turned by 180 degrees. Only the phase differs: deconvolved with the PSF of the right side a
patch is a photograph, whose gradients are few and large. With the other side's, which has the same
gain at every frequency, its phases are scrambled, and the same power is spread over all pixels.
"""

from functools import cache

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.depth.decoders.posterior import (
    is_uninformative,
    level_deviation,
    level_probability,
)
from coded_aperture_ros.depth.decoders.regularize import Regularizer
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.frames import (
    PatchGrid,
    extend_periodically,
    periodic_shape,
    transfer_function,
)
from coded_aperture_ros.frames.patches import window_means
from coded_aperture_ros.likelihood.bank import image_prior
from coded_aperture_ros.optics import PsfStack

# Largest difference of levels between neighbours of one surface.
_ONE_SURFACE = 3.0
# Weight of a patch's log-odds of the sides beside the cost: windows overlap, and a texture that
# looks like one of the other side does so in many of them. Fitted on simulated scenes, so that the
# side's confidence is calibrated.
_PATCH_ODDS_WEIGHT = 0.15
# Model error of one blur size for the whole frame, as a share of the texture at every frequency.
_MODEL_ERROR = 0.1
# Floor of the gradients, as a share of those around them, and of squared gradients everywhere.
_GRADIENT_FLOOR = 0.1
_TINY = 1e-12
# Log-odds for a difference of one in the mean logarithm of the squared gradients, on planes with
# photographs, and the largest log-odds of a patch.
_GAIN = 15.0
_MOST_LOG_ODDS = 6.0
# Margin that frames are extended by, at least, and side of the box around a gradient, px.
_AROUND_PX = 32


class FocalSides:
    """Distinguishes levels of the two sides of the focal plane, for frames of one size.

    Parameters
    ----------
    stack : PsfStack
    levels : Levels
    shape : (int, int)
        Rows and columns of the frames.
    regularize : Regularizer
        Chooses the blur sizes that frames are deconvolved with.
    by_costs : bool
        Whether the costs alone distinguish the sides, patch by patch, as those of two frames at two
        focus settings do.

    References
    ----------
    Martinello 2012, section 9.3.
    """

    def __init__(
        self,
        stack: PsfStack,
        levels: Levels,
        shape: tuple[int, ...],
        regularize: Regularizer,
        by_costs: bool = False,
    ) -> None:
        self._by_costs = by_costs
        self._finder = SideFinder(stack, shape)
        self._sizes_px = stack.blur_sizes_px
        self._regularize = regularize
        self._ambiguous = _ambiguous_levels(levels)

    def weigh(self, volume: FloatArray, observation: Observation, grey: FloatArray) -> FloatArray:
        """Cost of every level by spectrum and phase [rows, columns, L].

        The spectrum gives the blur size, the same for both sides. The frame is deconvolved with the
        PSF of that size and with the same turned by 180 degrees, and the levels of the less likely
        side cost more: by the mean log-odds of the patch and its neighbours of about that blur.

        Parameters
        ----------
        volume : ndarray, float32 [rows, columns, L]
            Cost by the spectrum alone.
        observation : Observation
        grey : ndarray, float32 [height, width]
            The frame, or a mean of frames.
        """
        sizes, grid = self._sizes_px, observation.grid
        longer = np.sign(sizes[np.abs(sizes).argmax()])
        one_side = np.flatnonzero(sizes * longer >= 0)
        size_cost = volume[..., one_side]
        levels = self._regularize(size_cost, size_cost, observation.brightness, grid.stride_px)
        chosen = np.rint(levels).astype(np.intp)
        far = self._finder.log_odds(grey, grid, one_side[chosen], observation.noise.typical)
        far[is_uninformative(level_probability(volume))] = 0
        levels = chosen.astype(np.float32)
        far = _sum_over_surface(far, levels, grid) / _sum_over_surface(
            np.ones_like(far), levels, grid
        )
        far *= np.float32(_PATCH_ODDS_WEIGHT)
        # -log p of each level's side.
        both = volume + np.logaddexp(0, -np.sign(sizes).astype(np.float32) * far[..., None])
        both -= both.min(axis=-1, keepdims=True)
        return np.asarray(both, np.float32)

    def condition_on_side(self, probability: FloatArray) -> FloatArray:
        """Probability of every level given its side [rows, columns, L]."""
        return condition_on_side(probability, self._sizes_px)

    def confidence(self, level: FloatArray, volume: FloatArray, grid: PatchGrid) -> FloatArray:
        """Probability that each patch is on the side of its level; see `side_confidence`."""
        if self._by_costs:
            odds = far_log_odds(volume, self._sizes_px, _MOST_LOG_ODDS)
            far = np.interp(level, np.arange(len(self._sizes_px)), self._sizes_px) > 0
            return np.asarray(1 / (1 + np.exp(np.where(far, -odds, odds))), np.float32)
        return side_confidence(level, far_log_odds(volume, self._sizes_px), grid, self._sizes_px)

    def deviation(
        self, level: FloatArray, volume: FloatArray, patches: tuple[IndexArray, IndexArray]
    ) -> FloatArray:
        """Standard deviation of levels given their sides; see `level_deviation`."""
        far = self._sizes_px > 0
        beyond, before = (
            level_deviation(level, volume, patches, np.flatnonzero(side)) for side in (far, ~far)
        )
        return np.where(far[np.rint(level).astype(np.intp)], beyond, before)

    def is_ambiguous(self, level: FloatArray) -> BoolArray:
        """Where the level of the same blur on the other side is equivalent [rows, columns]."""
        return np.asarray(self._ambiguous[np.rint(level).astype(np.intp)])


def _ambiguous_levels(levels: Levels) -> BoolArray:
    """Levels to which that of the same blur on the other side is equivalent, bool [L]."""
    sizes, index = levels.blur_sizes_px, np.arange(len(levels))
    order = np.argsort(sizes)
    mirrored = np.rint(np.interp(-sizes, sizes[order], index[order]))
    first, last = levels.agreement
    # A size that the other side does not have is on this one.
    agree = (-sizes >= sizes.min()) & (-sizes <= sizes.max())
    return np.asarray(agree & (first <= mirrored) & (mirrored <= last))


def condition_on_side(probability: FloatArray, blur_sizes_px: DoubleArray) -> FloatArray:
    """Probability of every level given its side of the focal plane [rows, columns, L].

    Uninformative patches keep their probabilities.
    """
    given = probability.copy()
    for side in (blur_sizes_px > 0, blur_sizes_px <= 0):
        total = given[..., side].sum(axis=-1, keepdims=True)
        given[..., side] /= np.maximum(total, np.float32(1e-12))
    known = ~is_uninformative(probability)
    return np.where(known[..., None], given, probability)


def far_log_odds(
    volume: FloatArray,
    blur_sizes_px: DoubleArray,
    surest: float = _PATCH_ODDS_WEIGHT * _MOST_LOG_ODDS,
) -> FloatArray:
    """Log-odds that a patch lies beyond the focal plane [rows, columns], at most `surest`.

    From the cost of all levels [rows, columns, L], which includes that some blur sizes exist on one
    side only. The limit keeps a wrong blur size from outweighing the phase.
    """
    probability = level_probability(volume)
    far, near = (
        probability[..., side].sum(axis=-1) + np.float32(1e-6)
        for side in (blur_sizes_px > 0, blur_sizes_px < 0)
    )
    return np.asarray(np.clip(np.log(far / near), -surest, surest), np.float32)


def side_confidence(
    level: FloatArray, log_odds: FloatArray, grid: PatchGrid, blur_sizes_px: DoubleArray
) -> FloatArray:
    """Probability that each patch is on the side of its level [rows, columns].

    From the log-odds of the patch and its neighbours on the same surface: `level` are the
    fractional levels that were chosen, `log_odds` the `far_log_odds`, both [rows, columns].
    """
    # Overlapping windows are not independent.
    independent = _sum_over_surface(log_odds, level, grid) / _patches_per_window(grid) ** 2
    side = np.sign(np.interp(level, np.arange(len(blur_sizes_px)), blur_sizes_px))
    return np.asarray(1 / (1 + np.exp(-side * independent)), np.float32)


def _patches_per_window(grid: PatchGrid) -> int:
    """Patches from one window to the next that does not overlap it."""
    return max(round(grid.window_px / grid.stride_px), 1)


def _sum_over_surface(values: FloatArray, level: FloatArray, grid: PatchGrid) -> FloatArray:
    """Sum over each patch and its neighbours on the same surface [rows, columns]."""
    reach = _patches_per_window(grid)
    rows, columns = values.shape
    other_levels = np.pad(level, reach, constant_values=np.float32(np.inf))
    others = np.pad(values, reach)
    total = np.zeros_like(values)
    for down in range(2 * reach + 1):
        for right in range(2 * reach + 1):
            shifted = slice(down, down + rows), slice(right, right + columns)
            same = np.abs(other_levels[shifted] - level) <= _ONE_SURFACE
            total += np.where(same, others[shifted], 0)
    return total


class SideFinder:
    """Log-odds of the two sides of the focal plane, for frames of one size."""

    def __init__(self, stack: PsfStack, shape: tuple[int, ...]) -> None:
        self._stack = stack
        self._shape = shape
        self._around_px = max(_AROUND_PX, stack.psfs.shape[-1] - 1)
        self._periodic = periodic_shape(shape, self._around_px)
        self._prior = image_prior(self._periodic)
        self._transfer = cache(lambda level: transfer_function(stack.psfs[level], self._periodic))

    def log_odds(
        self, grey: FloatArray, grid: PatchGrid, level: IndexArray, noise: float
    ) -> FloatArray:
        """Log-odds that each patch lies beyond the focal plane [rows, columns].

        Natural logarithms, 0 where the PSFs of both sides are the same. `grey` is linear light
        without NaN, `level` [rows, columns] has each patch's blur size, of either side.
        """
        spectrum = scipy.fft.rfft2(extend_periodically(grey - grey.mean(), self._periodic))
        odds = np.zeros(level.shape, np.float32)
        for one in np.unique(level):
            clearer = self._gradient_log_ratio(spectrum, int(one), noise)
            own_side = np.float32(np.sign(self._stack.blur_sizes_px[one]))
            here = level == one
            odds[here] = own_side * _GAIN * window_means(clearer, grid, grid.window_px)[here]
        return np.clip(odds, -_MOST_LOG_ODDS, _MOST_LOG_ODDS)

    def _gradient_log_ratio(
        self, spectrum: NDArray[np.complex64], level: int, noise: float
    ) -> FloatArray:
        """Log-ratio of squared gradients, deconvolved by the turned PSF and by a level's own.

        Of every pixel [height, width]; positive where the level's own PSF gives the sparser image.
        """
        transfer = self._transfer(level)
        passed = transfer.real**2 + transfer.imag**2
        power = (passed + np.float32(_MODEL_ERROR**2)) * self._prior + np.float32(noise**2)
        filtered = spectrum * (self._prior / power)
        own = self._gradients(filtered * np.conj(transfer))
        other = self._gradients(filtered * transfer)  # the transform of the PSF turned around
        logarithm = np.zeros(self._shape, np.float32)
        for mine, others in zip(own, other, strict=True):
            side = (self._around_px | 1,) * 2
            floor = _GRADIENT_FLOOR**2 / 2 * cv2.blur(mine + others, side) + _TINY
            logarithm += cv2.log((others + floor) / (mine + floor))
        return logarithm

    def _gradients(self, transform: NDArray[np.complex64]) -> list[FloatArray]:
        """Squared differences to the right and down, within the frame [height, width] each."""
        sharp = scipy.fft.irfft2(transform, self._periodic)
        height, width = self._shape
        here = sharp[:height, :width]
        right, below = sharp[:height, 1 : width + 1], sharp[1 : height + 1, :width]
        return [np.square(right - here), np.square(below - here)]
