"""From costs to probabilities: of every level, that the estimated one is right, and how nearly."""

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray

# Offset and slope of the logistic calibration of a patch's probability, fitted on ray-traced
# scenes, and how sure a patch may be.
_CALIBRATION = (0.7, 0.22)
_SURE = 1e-3
# What a level is off by at least, in levels, and the factor of all deviations: of random scenes'
# errors 68 % are within one, and as many where the deviation is small as where it is large.
_LEAST_DEVIATION = 2.0
_DEVIATION = 0.18


def refine_level(cost: FloatArray, level: IndexArray) -> FloatArray:
    """Refine whole levels by the parabola through each level's cost and its neighbours'.

    At most half a level is added or taken away. At the ends of the range, and where the cost
    is not convex, the level stays whole.
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
    """Return the probability of every level from its cost.

    Takes and gives [rows, columns, L]; sums to one over the levels.
    """
    probability = np.exp(-volume)
    probability /= probability.sum(axis=-1, keepdims=True)
    return probability


def nearest_plausible_level(
    probability: FloatArray, nearest_first: IndexArray, share: float
) -> IndexArray:
    """Level [rows, columns] that a patch's true level is nearer than with a share of probability.

    From the probability [rows, columns, L]; `nearest_first` are the levels, ordered by depth.
    """
    nearer = np.cumsum(probability[..., nearest_first], axis=-1)
    rank = (nearer < share).sum(axis=-1)
    return np.asarray(nearest_first[np.minimum(rank, len(nearest_first) - 1)])


def confidence_of(
    level: FloatArray,
    probability: FloatArray,
    patches: tuple[IndexArray, IndexArray],
    agreement: IndexArray,
) -> FloatArray:
    """Return the probability that the true level agrees with the estimated one.

    The probability that a pixel's own patch gives to the level is calibrated: near depth edges a
    patch is surer than it should be, and what its neighbours have decided may be right against it.
    Where a patch is uninformative, the level is its neighbours' alone, and the confidence that of a
    guess.

    Takes the fractional level of every pixel [rows, columns], the probability of the patches [grid
    rows, grid columns, L], see `level_probability`, the patch of every row and of every column of
    pixels, see `MapGrid`, and the first and last level that is as good as each level [2, L], see
    `Levels`. Returns float32 in [0, 1]; where the patch knows something, between 0.31 and 0.90.
    """
    # For every level that a patch may be given, as there are fewer of these than pixels.
    levels = probability.shape[-1]
    by_level = np.ascontiguousarray(np.moveaxis(probability, -1, 0))
    up_to = np.zeros((levels + 1, *by_level.shape[1:]), np.float32)
    for below, own, total in zip(up_to, by_level, up_to[1:], strict=False):
        np.add(below, own, out=total)
    first, last = agreement
    mass = up_to[last + 1] - up_to[first]
    offset, slope = map(np.float32, _CALIBRATION)
    odds_against = 1 / np.clip(mass, _SURE, 1 - _SURE) - 1
    odds_against = np.exp(slope * np.log(odds_against) - offset)
    confidence = 1 / (1 + odds_against)
    guessed = is_uninformative(probability)
    if guessed.any():
        # With few levels a guess is often right; it is no surer than who knows least.
        least = 1 / (1 + np.exp(-offset) * (1 / _SURE - 1) ** slope)
        confidence = np.where(guessed, np.minimum(mass, least), confidence)
    rows, columns = patches
    index = np.rint(level).astype(np.int32)
    index *= guessed.size
    index += (rows * guessed.shape[1]).astype(np.int32)[:, None]
    index += columns.astype(np.int32)
    # All are within: not checking it is quicker.
    return confidence.astype(np.float32, copy=False).ravel().take(index, mode="clip")


def level_deviation(
    level: FloatArray,
    volume: FloatArray,
    patches: tuple[IndexArray, IndexArray],
    among: IndexArray | None = None,
) -> FloatArray:
    """Return the standard deviation of the estimated levels, in levels, above 0.

    The spread of what a pixel's own patch finds probable, and how far the estimated level is from
    its mean: near depth edges, and where neighbours have decided. The patch is as much less sure
    than it says as for the confidence.

    Takes the fractional level of every pixel [rows, columns], the cost of the patches [grid rows,
    grid columns, L], the patch of every row and of every column of pixels, see `MapGrid`, and
    `among` which levels the true one may be; by default all. Returns float32 [rows, columns].
    """
    index = np.arange(volume.shape[-1], dtype=np.float32)
    if among is not None:
        index, volume = index[among], volume[..., among]
        volume = volume - volume.min(axis=-1, keepdims=True)
    probability = level_probability(volume * np.float32(_CALIBRATION[1]))
    mean = probability @ index
    variance = probability @ index**2 - mean**2
    rows, columns = patches

    def of_pixels(values: FloatArray) -> FloatArray:
        return values.take(columns, axis=1).take(rows, axis=0)

    square = level - of_pixels(mean)
    square *= square
    square += of_pixels(np.maximum(variance, 0) + np.float32(_LEAST_DEVIATION**2))
    np.sqrt(square, out=square)
    square *= np.float32(_DEVIATION)
    return square


def is_uninformative(probability: FloatArray) -> BoolArray:
    """Return which patches [rows, columns] find all levels alike."""
    return probability.max(axis=-1) <= 1.0001 / probability.shape[-1]
