"""Bounds of what half-cells may show: quantiles of their blur sizes, and the nearest around."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray, constant, filters, namespace
from coded_aperture_ros.depth.decoders.network.probabilities import HalfCells
from coded_aperture_ros.depth.levels import Levels

# Position error of the map, px of the frame: a pixel may show its neighbour's surface.
_AROUND_PX = 4
# Least probability in a division.
_LEAST_PROBABILITY = 1e-6


def nearest_px(cells: HalfCells, probability: float, far: FloatArray) -> FloatArray:
    """Signed blur size, px, with a given probability of being nearer [rows, columns].

    `far` is the probability of lying beyond the focal plane [rows, columns].
    """
    xp = namespace(far)
    front = xp.maximum(1 - far, _LEAST_PROBABILITY)
    # In front of the focal plane the nearer surface is the more blurred one.
    before = -quantile_px(cells, 1 - xp.minimum(probability / front, 1))
    beyond = quantile_px(cells, (probability - front) / xp.maximum(far, _LEAST_PROBABILITY))
    nearest: FloatArray = xp.where(front < probability, beyond, before)
    return nearest


def quantile_px(cells: HalfCells, share: float | NDArray[np.floating]) -> FloatArray:
    """Quantile of the unsigned blur size, px [rows, columns]."""
    xp = namespace(cells.logits)
    probability = xp.exp(cells.logits - xp.amax(cells.logits, 0))
    left = share * probability.sum(axis=0)
    if xp is not np:  # few large operations
        return constant(cells.tried_px, left)[(left > xp.cumsum(probability[:-1], 0)).sum(0)]
    rank = np.zeros(left.shape, np.intp)
    for each in probability[:-1]:
        left -= each
        rank += left > 0
    return cells.tried_px[rank]


def nearest_level_around(
    level: FloatArray, levels: Levels, error: float, cell_px: float, pixel_px: float
) -> FloatArray:
    """Nearest level around every cell, less an error in levels [rows, columns].

    `cell_px` and `pixel_px` are the sides of the cells and of the map's pixels, px of the frame.
    """
    xp, cv = namespace(level), filters(level)
    reach = int(np.ceil((_AROUND_PX + (pixel_px - 1) / 2) / cell_px))
    square = np.ones((2 * reach + 1,) * 2, np.uint8)
    if levels.nearest_first[0] == 0:
        return xp.maximum(cv.erode(level, square) - error, 0)
    last = len(levels) - 1
    return xp.minimum(cv.dilate(level, square) + error, last)
