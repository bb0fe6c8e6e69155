"""Depth beside edges by NumPy, where there is no numba."""

import numpy as np
from scipy.ndimage import map_coordinates

from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.depth.moving.geometry import LEAST_DEPTH, Way
from coded_aperture_ros.depth.moving.matching_plain import Pair

# Pixels to each side within which the light is compared.
REACH = 1
# Difference of two inverse depths, as a share, that is an edge.
EDGE = 0.06
# Another surface is taken if it leaves so much less: with 1.5 edges of some rooms were worse.
BETTER = 2.5
# No difference of square roots of light counts more than this one.
MOST = 0.03
# Inverse depth of every pixel, and the largest and the least around it.
Surfaces = tuple[FloatArray, FloatArray, FloatArray]


def settle_plain(
    pair: Pair, way: Way, surfaces: Surfaces, noise: np.float32, found: FloatArray
) -> None:
    """Form of `settle` for NumPy."""
    inverse, nearest, farthest = surfaces
    found[:] = inverse
    beside = nearest - farthest > EDGE * nearest
    beside[:REACH], beside[-REACH:] = False, False
    beside[:, :REACH], beside[:, -REACH:] = False, False
    rows, columns = np.nonzero(beside)
    least, inside = _left_over(pair, way, (rows, columns), inverse[beside])
    chosen = inverse[beside]
    least = np.where(inside, least, np.float32(np.inf))
    for surface in (nearest[beside], farthest[beside]):
        left, inside = _left_over(pair, way, (rows, columns), surface)
        better = inside & (left * np.float32(BETTER) + 2 * noise * noise < least)
        chosen, least = np.where(better, surface, chosen), np.where(better, left, least)
    found[beside] = chosen


def _left_over(
    pair: Pair, way: Way, at: tuple[np.ndarray, np.ndarray], inverse: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Mean squared difference around pixels [n], and whether the earlier frame shows them all."""
    (now, earlier), (turn, shift) = pair, way
    total, inside = np.zeros(len(inverse), np.float32), np.ones(len(inverse), np.bool_)
    last = np.array(earlier.shape)[:, None] - 1
    for down in range(-REACH, REACH + 1):
        for across in range(-REACH, REACH + 1):
            row, column = at[0] + down, at[1] + across
            x, y, z = (
                each[0] * column + each[1] * row + each[2] + moved * inverse
                for each, moved in zip(turn, shift, strict=True)
            )
            there = np.stack([y, x]) / np.maximum(z, LEAST_DEPTH)
            inside &= ((there >= 0) & (there < last)).all(axis=0)
            shown = map_coordinates(earlier, there, order=1, mode="nearest")
            total += np.minimum(np.square(shown - now[row, column]), np.float32(MOST**2))
    return total / np.float32((2 * REACH + 1) ** 2), inside
