"""Posterior of the levels: their probabilities, confidence and standard deviation."""

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray

# Offset and slope of the logistic calibration of a patch's log-odds, fitted on ray-traced scenes.
_CALIBRATION = (0.7, 0.22)
# Least distance of a patch's probability from 0 and 1.
_SURE = 1e-3
# Least error, in levels before scaling, and factor of all standard deviations. Fitted so that 68 %
# of random scenes' errors are within one, whether it is small or large.
_LEAST_DEVIATION = 2.0
_DEVIATION = 0.18


def refine_level(cost: FloatArray, level: IndexArray) -> FloatArray:
    """Fractional level at the vertex of the parabola through a level's cost and its neighbours'.

    Takes costs [..., L] and whole levels [...]. The result differs by at most half a level. At the
    ends of the range, and where the cost is not convex, the level stays whole.
    """
    last = cost.shape[-1] - 1
    if last < 2:
        return level.astype(np.float32)
    inner = np.clip(level, 1, last - 1)[..., None]
    below, here, above = (
        np.take_along_axis(cost, inner + step, axis=-1)[..., 0] for step in (-1, 0, 1)
    )
    curvature = below - 2 * here + above
    convex = (curvature > 0) & (inner[..., 0] == level)
    vertex = np.divide(below - above, 2 * curvature, out=np.zeros_like(here), where=convex)
    return (level + np.clip(vertex, -0.5, 0.5)).astype(np.float32)


def level_probability(volume: FloatArray) -> FloatArray:
    """Probability of every level [rows, columns, L] from its cost; the sum over levels is 1."""
    probability = np.exp(-volume)
    probability /= probability.sum(axis=-1, keepdims=True)
    return probability


def nearest_plausible_level(
    probability: FloatArray, nearest_first: IndexArray, share: float
) -> IndexArray:
    """Level [rows, columns] below which a share of the probability is nearer: a quantile of depth.

    Takes the probability of every level [rows, columns, L] and the levels ordered by depth [L].
    """
    nearer = np.cumsum(probability[..., nearest_first], axis=-1)
    rank = (nearer < share).sum(axis=-1)
    return np.asarray(nearest_first[np.minimum(rank, len(nearest_first) - 1)])


def level_confidence(
    level: FloatArray,
    probability: FloatArray,
    patches: tuple[IndexArray, IndexArray],
    agreement: IndexArray,
) -> FloatArray:
    """Probability that the true level is equivalent to the estimated one, of every pixel.

    It is the calibrated probability by the pixel's nearest patch: near depth edges a patch is
    overconfident, and its neighbours' level may be right against it. Where a patch is
    uninformative, the level comes from its neighbours and the confidence is that of a guess.

    Parameters
    ----------
    level : ndarray, float32 [rows, columns]
        Fractional level of every pixel.
    probability : ndarray, float32 [grid rows, grid columns, L]
        As from `level_probability`.
    patches : (ndarray, ndarray), intp [rows], [columns]
        Nearest patch of every row and column of pixels; see `MapGrid`.
    agreement : ndarray, intp [2, L]
        First and last level that is equivalent to each level; see `Levels`.

    Returns
    -------
    ndarray, float32 [rows, columns]
        In [0, 1]; where the patch is informative, between 0.31 and 0.90.
    """
    # Computed for every level of every patch: there are fewer of these than pixels.
    levels = probability.shape[-1]
    by_level = np.ascontiguousarray(np.moveaxis(probability, -1, 0))
    up_to = np.zeros((levels + 1, *by_level.shape[1:]), np.float32)
    for below, of_level, total in zip(up_to, by_level, up_to[1:], strict=False):
        np.add(below, of_level, out=total)
    first, last = agreement
    mass = up_to[last + 1] - up_to[first]
    offset, slope = map(np.float32, _CALIBRATION)
    odds_against = 1 / np.clip(mass, _SURE, 1 - _SURE) - 1
    odds_against = np.exp(slope * np.log(odds_against) - offset)
    confidence = 1 / (1 + odds_against)
    guessed = is_uninformative(probability)
    if guessed.any():
        # With few levels a guess is often right; its confidence stays below any informed one.
        least = 1 / (1 + np.exp(-offset) * (1 / _SURE - 1) ** slope)
        confidence = np.where(guessed, np.minimum(mass, least), confidence)
    rows, columns = patches
    index = np.rint(level).astype(np.int32)
    index *= guessed.size
    index += (rows * guessed.shape[1]).astype(np.int32)[:, None]
    index += columns.astype(np.int32)
    # All indices are within bounds; "clip" skips the check, which is quicker.
    return confidence.astype(np.float32, copy=False).ravel().take(index, mode="clip")


def level_deviation(
    level: FloatArray,
    volume: FloatArray,
    patches: tuple[IndexArray, IndexArray],
    among: IndexArray | None = None,
) -> FloatArray:
    """Standard deviation of the estimated level of every pixel, in levels, > 0.

    It combines the spread of the nearest patch's posterior, flattened as for the confidence, with
    the distance of the estimated level from its mean, which is large near depth edges and where
    neighbours have decided.

    Parameters
    ----------
    level : ndarray, float32 [rows, columns]
        Fractional level of every pixel.
    volume : ndarray, float32 [grid rows, grid columns, L]
        Cost of every level of the patches.
    patches : (ndarray, ndarray), intp [rows], [columns]
        Nearest patch of every row and column of pixels; see `MapGrid`.
    among : ndarray, intp [n], optional
        Levels that the true one may be; all by default.

    Returns
    -------
    ndarray, float32 [rows, columns]
    """
    index = np.arange(volume.shape[-1], dtype=np.float32)
    if among is not None:
        index, volume = index[among], volume[..., among]
        volume = volume - volume.min(axis=-1, keepdims=True)
    probability = level_probability(volume * np.float32(_CALIBRATION[1]))
    mean = probability @ index
    variance = probability @ index**2 - mean**2
    rows, columns = patches

    def to_pixels(values: FloatArray) -> FloatArray:
        return values.take(columns, axis=1).take(rows, axis=0)

    square = level - to_pixels(mean)
    square *= square
    square += to_pixels(np.maximum(variance, 0) + np.float32(_LEAST_DEVIATION**2))
    np.sqrt(square, out=square)
    square *= np.float32(_DEVIATION)
    return square


def is_uninformative(probability: FloatArray) -> BoolArray:
    """Patches whose levels are all about equally probable [rows, columns]."""
    return probability.max(axis=-1) <= 1.0001 / probability.shape[-1]
