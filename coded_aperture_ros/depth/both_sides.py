"""Levels on both sides of the focal plane: the evidence of the two, and how sure the side is."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank import FilterBank
from coded_aperture_ros.depth.config import DepthConfig
from coded_aperture_ros.depth.levels import knows_nothing, level_probability
from coded_aperture_ros.depth.regularize import regularized_level
from coded_aperture_ros.depth.side import MOST_LOG_ODDS, SideFinder
from coded_aperture_ros.imaging import PatchGrid

# Neighbours within a window's side whose levels differ by at most so many are one surface.
_ONE_SURFACE = 3.0
# A patch's odds of the sides count with this share beside the evidence of its spectrum: windows
# overlap, and a texture that looks like one of the other side does so in many of them. From
# simulated scenes; with it, the confidence of the side is about how often it is right.
_SHARE = 0.15
# A mask with less asymmetry, as `Mask.asymmetry` has it, does not tell the sides.
_LEAST_ASYMMETRY = 0.05


def has_both_sides(bank: FilterBank) -> bool:
    """Return whether a bank has levels before and behind the focal plane."""
    sizes = bank.blur_sizes_px
    return bool(bank.stack.in_pixels and (sizes < 0).any() and (sizes > 0).any())


def side_warning(bank: FilterBank) -> str | None:
    """Return one line if a bank has levels on both sides that its mask does not tell apart."""
    if not has_both_sides(bank):
        return None
    psf = bank.stack.psfs[np.abs(bank.blur_sizes_px).argmax()]
    if np.abs(psf - psf[::-1, ::-1]).sum() / 2 >= _LEAST_ASYMMETRY:
        return None
    return (
        "side: the mask is nearly the same after half a turn, so the blur does not tell the two "
        "sides of the focal plane apart: use an asymmetric mask such as three_wide or zhou, or "
        "focus before or beyond the scene"
    )


def with_side(
    evidence: NDArray[np.float32],
    finder: SideFinder,
    bank: FilterBank,
    grey: NDArray[np.float32],
    grid: PatchGrid,
    noise: float,
    config: DepthConfig,
    brightness: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Return the evidence against every level, where it is the spectrum's, with that of its phase.

    Spectra tell the size of the blur. With the PSF of that size, and with the same turned by 180
    degrees, the frame is deconvolved, and the levels of the less likely side get evidence against
    them: by the mean of the patch and its neighbours with about the same blur.

    Parameters
    ----------
    evidence : ndarray, float32 [rows, columns, L]
        See `level_evidence`; the same for both sides.
    finder : SideFinder
    bank : FilterBank
    grey : ndarray, float32 [height, width]
        The frame.
    grid : PatchGrid
    noise : float
        Standard deviation of the frame's noise.
    config : DepthConfig
        Says how blur sizes are regularised.
    brightness : ndarray, float32 [rows, columns], optional
        See `regularized_level`.
    """
    sizes = bank.blur_sizes_px
    longer = np.sign(sizes[np.abs(sizes).argmax()])
    one_side = np.flatnonzero(sizes * longer >= 0)
    of_sizes = evidence[..., one_side]
    chosen = np.rint(regularized_level(of_sizes, config, brightness)).astype(np.intp)
    far = finder.log_odds(grey, grid, one_side[chosen], noise)
    far[knows_nothing(level_probability(evidence))] = 0
    levels = chosen.astype(np.float32)
    far = _around(far, levels, grid) / _around(np.ones_like(far), levels, grid)
    far *= np.float32(_SHARE)
    # -log p of each level's side.
    against = np.logaddexp(0, -np.sign(sizes).astype(np.float32) * far[..., None])
    both = evidence + against
    both -= both.min(axis=-1, keepdims=True)
    return np.asarray(both, np.float32)


def given_side(
    probability: NDArray[np.float32], blur_sizes_px: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the probability of every level if its side of the focal plane is the right one.

    Takes and gives [rows, columns, L]. Patches that know nothing are left as they are.
    """
    given = probability.copy()
    for side in (blur_sizes_px > 0, blur_sizes_px <= 0):
        total = given[..., side].sum(axis=-1, keepdims=True)
        given[..., side] /= np.maximum(total, np.float32(1e-12))
    known = ~knows_nothing(probability)
    return np.where(known[..., None], given, probability)


def far_log_odds(
    evidence: NDArray[np.float32], blur_sizes_px: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the logarithm of the odds that a patch is beyond the focal plane [rows, columns].

    From the evidence against all levels [rows, columns, L]: a blur size that only one side has
    tells it too.
    """
    probability = level_probability(evidence)
    far, near = (
        probability[..., side].sum(axis=-1) + np.float32(1e-6)
        for side in (blur_sizes_px > 0, blur_sizes_px < 0)
    )
    # A size mistaken for one that only one side has must not outweigh all that phases tell.
    surest = np.float32(_SHARE * MOST_LOG_ODDS)
    return np.asarray(np.clip(np.log(far / near), -surest, surest), np.float32)


def side_confidence(
    level: NDArray[np.float32],
    log_odds: NDArray[np.float32],
    grid: PatchGrid,
    blur_sizes_px: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Return how likely it is that each patch is on the side of its level.

    What the patch and its neighbours on the same surface tell, together.

    Parameters
    ----------
    level : ndarray, float32 [rows, columns]
        Chosen fractional levels.
    log_odds : ndarray, float32 [rows, columns]
        See `far_log_odds`.
    grid : PatchGrid
    blur_sizes_px : ndarray, float64 [L]
        Signed.

    Returns
    -------
    ndarray, float32 [rows, columns]
        Probability.
    """
    # Windows that overlap tell the same again.
    independent = _around(log_odds, level, grid) / _reach(grid) ** 2
    side = np.sign(np.interp(level, np.arange(len(blur_sizes_px)), blur_sizes_px))
    return np.asarray(1 / (1 + np.exp(-side * independent)), np.float32)


def _reach(grid: PatchGrid) -> int:
    """Return how many patches away the next window begins."""
    return max(round(grid.window_px / grid.stride_px), 1)


def _around(
    values: NDArray[np.float32], level: NDArray[np.float32], grid: PatchGrid
) -> NDArray[np.float32]:
    """Return the sum over each patch and its neighbours on the same surface [rows, columns]."""
    reach = _reach(grid)
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
