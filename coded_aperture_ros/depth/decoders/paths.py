"""The cheapest sequence of levels up to each patch, along one axis; see `semi_global_cost`."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.compiled import Compiled


def _loop(
    volume: FloatArray, weights: FloatArray, p1: np.float32, p2: np.float32, total: FloatArray
) -> None:
    rows, columns, levels = volume.shape
    # Beyond the first and last level nothing is cheap.
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
