"""Semi-global matching: cost of every level along the cheapest paths through the patches."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, Shape, namespace
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.depth.decoders.paths import add_best_paths_plain

# Largest cost of a level, natural logarithm: beyond, a patch is an outlier.
_MOST_COST = 7.0
# Costs of a step of one level and of a jump, natural logarithm.
P1 = 4.0
P2 = 22.0
# Share of the smoothness that is left where the brightness changes by much more than usual.
_ACROSS_CONTRAST = 0.3


def _loop(
    volume: FloatArray, weights: FloatArray, p1: np.float32, p2: np.float32, total: FloatArray
) -> None:
    rows, columns, levels = volume.shape
    # Levels beyond the first and last one are never the cheapest.
    previous = np.full((columns, levels + 2), np.float32(1e30), np.float32)
    here = np.empty(levels + 2, np.float32)
    for backwards in range(2):
        for step in range(rows):
            i = rows - 1 - step if backwards else step
            for j in range(columns):
                before = previous[j]
                if step == 0:
                    for level in range(levels):
                        here[1 + level] = volume[i, j, level]
                else:
                    weight = weights[i if backwards else i - 1, j]
                    of_step, of_jump = p1 * weight, p2 * weight
                    for level in range(levels):
                        beside = min(before[level], before[level + 2]) + of_step
                        best = min(min(before[level + 1], beside), of_jump)
                        here[1 + level] = volume[i, j, level] + best
                least = here[1]
                for level in range(1, levels):
                    least = min(least, here[1 + level])
                # So that costs do not grow along the path.
                for level in range(levels):
                    before[1 + level] = here[1 + level] - least
                    total[i, j, level] += before[1 + level]


# Adds to `total` [n, m, L] the costs, less the least of each patch, of the best paths that reach it
# from either end of the first axis. Takes the volume [n, m, L], the weight of the smoothness
# between neighbours [n - 1, m], and the costs P1 of a step of one level and P2 of a jump.
add_best_paths = Compiled(_loop, add_best_paths_plain)


def semi_global_cost(
    volume: FloatArray, smoothness: float, brightness: FloatArray | None
) -> FloatArray:
    """Sum of the costs of the best paths to every level of every patch [rows, columns, L].

    The four paths along rows and columns are minimised exactly, with a small cost for steps of one
    level, as of slants, and a larger one for jumps.

    Parameters
    ----------
    volume : ndarray, float32 [rows, columns, L]
        Cost of every level.
    smoothness : float
        Factor of the costs of steps and jumps.
    brightness : ndarray, float32 [rows, columns], or None
        Mean linear light of every patch; edges of it make jumps cheaper.

    References
    ----------
    H. Hirschmueller, Stereo processing by semiglobal matching and mutual information, 2008.
    """
    bounded = np.ascontiguousarray(bound_outliers(volume))
    down, across = smoothness_weights(bounded.shape[:2], smoothness, brightness)
    # Every path counts the cost of its patch.
    total = -3 * bounded
    add_best_paths(bounded, down, np.float32(P1), np.float32(P2), total)
    add_best_paths(
        bounded.swapaxes(0, 1), across.T, np.float32(P1), np.float32(P2), total.swapaxes(0, 1)
    )
    return total


def smoothness_weights(
    shape: Shape, smoothness: float, brightness: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Weight of the smoothness down [rows - 1, columns] and across [rows, columns - 1]."""
    rows, columns = shape
    if brightness is None or rows * columns == 1:
        equal = np.full(shape, smoothness, np.float32)
        return equal[1:], equal[:, 1:]
    xp = namespace(brightness)
    changes = [xp.abs(xp.diff(brightness, axis=axis)) for axis in (0, 1)]
    flat = xp.concatenate([change.ravel() for change in changes])
    ordered = np.sort(flat) if xp is np else flat.sort()[0]
    usual = (ordered[(len(flat) - 1) // 2] + ordered[len(flat) // 2]) / 2  # the median
    weights = [
        _ACROSS_CONTRAST
        + (1 - _ACROSS_CONTRAST) * xp.exp(-((change / xp.clip(usual, 1e-6, None)) ** 2))
        for change in changes
    ]
    mean = xp.concatenate([weight.ravel() for weight in weights]).mean()
    return float(smoothness) * (weights[0] / mean), float(smoothness) * (weights[1] / mean)


def bound_outliers(volume: FloatArray) -> FloatArray:
    """Negative logarithm of the probability of every level [..., L], at most an outlier's."""
    xp = namespace(volume)
    log_sum = xp.log(xp.exp(-volume).sum(axis=-1, keepdims=True))
    bounded: FloatArray = xp.clip(volume + log_sum, None, _MOST_COST)
    return bounded
