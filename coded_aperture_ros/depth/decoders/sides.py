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

# Neighbours within a window's side whose levels differ by at most so many are one surface.
_ONE_SURFACE = 3.0
# A patch's odds of the sides count with this share beside what its spectrum says: windows
# overlap, and a texture that looks like one of the other side does so in many of them. From
# simulated scenes; with it, the confidence of the side is about how often it is right.
_PATCH_ODDS_WEIGHT = 0.15
# What one blur size for the whole frame leaves unexplained, as a share of the texture at every
# frequency.
_MODEL_ERROR = 0.1
# Gradients below this share of their surroundings' are taken to be of one size.
_GRADIENT_FLOOR = 0.1
_TINY = 1e-12
# Natural logarithm of the odds for a difference of one in the mean logarithm of the squared
# gradients, on planes with photographs. No patch is surer than the second.
_GAIN = 15.0
_MOST_LOG_ODDS = 6.0
# Frames are extended by this, or by the width of the PSFs; it is what a gradient's surroundings
# are, too.
_AROUND_PX = 32


class FocalSides:
    """Tells the levels of the two sides of the focal plane apart, for frames of one size.

    The regulariser chooses the blur sizes that frames are deconvolved with. Those of two frames at
    two focus settings tell the sides by their costs, patch by patch.
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
        """Return the cost of every level by spectrum and phase, from that by the spectrum alone.

        Spectra tell the size of the blur, the same for both sides. With the PSF of that size, and
        with the same turned by 180 degrees, the frame, or a mean of frames, is deconvolved, and the
        levels of the less likely side cost more: by the mean of the patch and its neighbours with
        about the same blur.
        """
        sizes, grid = self._sizes_px, observation.grid
        longer = np.sign(sizes[np.abs(sizes).argmax()])
        one_side = np.flatnonzero(sizes * longer >= 0)
        of_sizes = volume[..., one_side]
        levels = self._regularize(of_sizes, of_sizes, observation.brightness, grid.stride_px)
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
        """Return the probability of every level if its side is the right one."""
        return condition_on_side(probability, self._sizes_px)

    def confidence(self, level: FloatArray, volume: FloatArray, grid: PatchGrid) -> FloatArray:
        """Return how likely each patch is on the side of its level; see `side_confidence`."""
        if self._by_costs:  # each patch knows
            odds = far_log_odds(volume, self._sizes_px, _MOST_LOG_ODDS)
            far = np.interp(level, np.arange(len(self._sizes_px)), self._sizes_px) > 0
            return np.asarray(1 / (1 + np.exp(np.where(far, -odds, odds))), np.float32)
        return side_confidence(level, far_log_odds(volume, self._sizes_px), grid, self._sizes_px)

    def deviation(
        self, level: FloatArray, volume: FloatArray, patches: tuple[IndexArray, IndexArray]
    ) -> FloatArray:
        """Return the deviation of levels if their sides are right; see `level_deviation`."""
        far = self._sizes_px > 0
        beyond, before = (
            level_deviation(level, volume, patches, np.flatnonzero(side)) for side in (far, ~far)
        )
        return np.where(far[np.rint(level).astype(np.intp)], beyond, before)

    def is_ambiguous(self, level: FloatArray) -> BoolArray:
        """Return where the level of the other side with the same blur is as good."""
        return np.asarray(self._ambiguous[np.rint(level).astype(np.intp)])


def _ambiguous_levels(levels: Levels) -> BoolArray:
    """Return for which levels that of the same blur on the other side is as good [L]."""
    sizes, index = levels.blur_sizes_px, np.arange(len(levels))
    order = np.argsort(sizes)
    mirrored = np.rint(np.interp(-sizes, sizes[order], index[order]))
    first, last = levels.agreement
    # A size that the other side does not have is on this one.
    agree = (-sizes >= sizes.min()) & (-sizes <= sizes.max())
    return np.asarray(agree & (first <= mirrored) & (mirrored <= last))


def condition_on_side(probability: FloatArray, blur_sizes_px: DoubleArray) -> FloatArray:
    """Return the probability of every level if its side of the focal plane is the right one.

    Takes and gives [rows, columns, L]. Patches that are uninformative are left as they are.
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
    """Return the logarithm of the odds that a patch is beyond the focal plane [rows, columns].

    From the cost of all levels [rows, columns, L]: a blur size that only one side has tells it too.
    One mistaken for such a size must not outweigh all that phases tell: none is above `surest`.
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
    """Return how likely it is that each patch is on the side of its level [rows, columns].

    What the patch and its neighbours on the same surface tell, together: from the fractional levels
    that were chosen and the `far_log_odds`, both [rows, columns].
    """
    # Windows that overlap tell the same again.
    independent = _sum_over_surface(log_odds, level, grid) / _patches_per_window(grid) ** 2
    side = np.sign(np.interp(level, np.arange(len(blur_sizes_px)), blur_sizes_px))
    return np.asarray(1 / (1 + np.exp(-side * independent)), np.float32)


def _patches_per_window(grid: PatchGrid) -> int:
    """Return how many patches away the next window begins."""
    return max(round(grid.window_px / grid.stride_px), 1)


def _sum_over_surface(values: FloatArray, level: FloatArray, grid: PatchGrid) -> FloatArray:
    """Return the sum over each patch and its neighbours on the same surface [rows, columns]."""
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
    """Tells the two sides of the focal plane apart, for frames of one size."""

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
        """Return the log-odds that each patch lies beyond the focal plane, not before it.

        Natural logarithms [rows, columns], 0 where the two PSFs are the same. `grey` is in linear
        light without NaN, `level` [rows, columns] has each patch's blur size, of either side.
        """
        spectrum = scipy.fft.rfft2(extend_periodically(grey - grey.mean(), self._periodic))
        found = np.zeros(level.shape, np.float32)
        for one in np.unique(level):
            clearer = self._gradient_log_ratio(spectrum, int(one), noise)
            own_side = np.float32(np.sign(self._stack.blur_sizes_px[one]))
            here = level == one
            found[here] = own_side * _GAIN * window_means(clearer, grid, grid.window_px)[here]
        return np.clip(found, -_MOST_LOG_ODDS, _MOST_LOG_ODDS)

    def _gradient_log_ratio(
        self, spectrum: NDArray[np.complex64], level: int, noise: float
    ) -> FloatArray:
        """Return by how much clearer the frame is by a level's PSF than by that turned around.

        The logarithm of the ratio of the squared gradients, of every pixel [height, width].
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
        """Return the squared differences to the right and down, within the frame."""
        sharp = scipy.fft.irfft2(transform, self._periodic)
        height, width = self._shape
        here = sharp[:height, :width]
        right, below = sharp[:height, 1 : width + 1], sharp[1 : height + 1, :width]
        return [np.square(right - here), np.square(below - here)]
