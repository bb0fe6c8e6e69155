"""Best paths through costs in few large operations: for tensors, and without numba for NumPy."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, namespace


def add_best_paths_plain(
    volume: FloatArray, weights: FloatArray, p1: np.float32, p2: np.float32, total: FloatArray
) -> None:
    """Form of `add_best_paths` for NumPy."""
    # Levels before patches: all that is done to every level is then one long run of numbers.
    costs = np.empty((len(volume), 2, volume.shape[2], volume.shape[1]), np.float32)
    costs[:, 0] = volume.swapaxes(1, 2)
    costs[:, 1] = costs[::-1, 0]
    both = np.stack([weights, weights[::-1]], axis=1)[:, :, None]
    follow_paths(costs, p1 * both, p2 * both)
    total += (costs[:, 0] + costs[::-1, 1]).swapaxes(1, 2)


def follow_paths(costs: FloatArray, of_step: FloatArray, of_jump: FloatArray) -> None:
    """Add to costs [n, paths, L, m] those of the best paths from the first, less the least of each.

    `of_step` and `of_jump` [n - 1, paths, 1, m] are the costs of steps and jumps between
    neighbours. For arrays and tensors.
    """
    xp = namespace(costs)
    step, best, least = (xp.empty_like(each) for each in (costs[0], costs[0], costs[0, :, :1]))
    for i in range(len(costs)):
        if i:
            previous = costs[i - 1]
            xp.minimum(previous, of_jump[i - 1], out=best)
            xp.add(previous, of_step[i - 1], out=step)
            xp.minimum(best[:, 1:], step[:, :-1], out=best[:, 1:])
            xp.minimum(best[:, :-1], step[:, 1:], out=best[:, :-1])
            xp.add(costs[i], best, out=costs[i])
        xp.amin(costs[i], 1, keepdims=True, out=least)
        xp.subtract(costs[i], least, out=costs[i])  # so that costs do not grow along the path
