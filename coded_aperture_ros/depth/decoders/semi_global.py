"""Semi-global matching: cost of every level along the cheapest paths through the patches."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.compiled import Compiled

# Largest cost of a level, natural logarithm: beyond, a patch is an outlier.
_MOST_COST = 7.0
# Costs of a step of one level and of a jump, natural logarithm.
_P1 = 4.0
_P2 = 22.0
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


def _plain(
    volume: FloatArray, weights: FloatArray, p1: np.float32, p2: np.float32, total: FloatArray
) -> None:
    # Levels before patches: all that is done to every level is then one long run of numbers.
    costs = np.empty((len(volume), 2, volume.shape[2], volume.shape[1]), np.float32)
    costs[:, 0] = volume.swapaxes(1, 2)
    costs[:, 1] = costs[::-1, 0]
    of_step = p1 * np.stack([weights, weights[::-1]], axis=1)[:, :, None]
    of_jump = p2 * np.stack([weights, weights[::-1]], axis=1)[:, :, None]
    step, best = np.empty_like(costs[0]), np.empty_like(costs[0])
    least = np.empty_like(costs[0, :, :1])
    for i in range(len(costs)):
        if i:
            previous = costs[i - 1]
            np.minimum(previous, of_jump[i - 1], out=best)
            np.add(previous, of_step[i - 1], out=step)
            np.minimum(best[:, 1:], step[:, :-1], out=best[:, 1:])
            np.minimum(best[:, :-1], step[:, 1:], out=best[:, :-1])
            np.add(costs[i], best, out=costs[i])
        np.minimum.reduce(costs[i], axis=1, keepdims=True, out=least)
        np.subtract(costs[i], least, out=costs[i])  # so that costs do not grow along the path
    total += (costs[:, 0] + costs[::-1, 1]).swapaxes(1, 2)


# Adds to `total` [n, m, L] the costs, less the least of each patch, of the best paths that reach it
# from either end of the first axis. Takes the volume [n, m, L], the weight of the smoothness
# between neighbours [n - 1, m], and the costs P1 of a step of one level and P2 of a jump.
add_best_paths = Compiled(_loop, _plain)


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
    rows, columns = bounded.shape[:2]
    down = np.full((rows - 1, columns), smoothness, np.float32)
    across = np.full((rows, columns - 1), smoothness, np.float32)
    if brightness is not None and brightness.size > 1:
        changes = [np.abs(np.diff(brightness, axis=axis)) for axis in (0, 1)]
        usual = np.median(np.concatenate([change.ravel() for change in changes]))
        weights = [
            _ACROSS_CONTRAST + (1 - _ACROSS_CONTRAST) * np.exp(-((change / max(usual, 1e-6)) ** 2))
            for change in changes
        ]
        mean = np.mean(np.concatenate([weight.ravel() for weight in weights]))
        down *= weights[0] / mean
        across *= weights[1] / mean
    # Every path counts the cost of its patch.
    total = -3 * bounded
    add_best_paths(bounded, down, np.float32(_P1), np.float32(_P2), total)
    add_best_paths(
        bounded.swapaxes(0, 1), across.T, np.float32(_P1), np.float32(_P2), total.swapaxes(0, 1)
    )
    return total


def bound_outliers(volume: FloatArray) -> FloatArray:
    """Negative logarithm of the probability of every level [..., L], at most an outlier's."""
    log_sum = np.log(np.exp(-volume).sum(axis=-1, keepdims=True))
    return np.minimum(volume + log_sum, np.float32(_MOST_COST))
