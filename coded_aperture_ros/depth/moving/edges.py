"""Depth beside edges: which of the surfaces there an earlier frame shows at each pixel.

Windows are as wide as several pixels, and pixels beside an edge are in windows of both its sides.
"""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.depth.moving.edges_plain import (
    BETTER,
    EDGE,
    MOST,
    REACH,
    Surfaces,
    settle_plain,
)
from coded_aperture_ros.depth.moving.geometry import LEAST_DEPTH, Way
from coded_aperture_ros.depth.moving.matching_plain import Pair

# Side of the square in which surfaces are looked for, px of the map.
_AROUND_PX = 5
_ZERO, _ONE, _TWO, _NONE = np.float32(0), np.float32(1), np.float32(2), np.float32(1e9)
_BETTER, _EDGE, _MOST = np.float32(BETTER), np.float32(EDGE), np.float32(MOST**2)
_SHARE = np.float32(1 / (2 * REACH + 1) ** 2)


def settled(
    inverse: FloatArray, now: FloatArray, earlier: FloatArray, way: Way, noise: float
) -> FloatArray:
    """Inverse depth, at edges that of the surface which an earlier frame shows [rows, columns].

    Parameters
    ----------
    inverse : ndarray, float32 [rows, columns]
    now, earlier : ndarray, float32 [rows, columns]
        Square roots of light of the present frame, as bright as the earlier one, and of that.
    way : Way
        From the present view to the earlier one.
    noise : float
        Standard deviation of the difference of both.
    """
    around = np.ones((_AROUND_PX, _AROUND_PX), np.uint8)
    surfaces = inverse, cv2.dilate(inverse, around), cv2.erode(inverse, around)
    found = np.empty_like(inverse)
    settle((now, earlier), way, surfaces, np.float32(noise), found)
    return found


def _loop(pair: Pair, way: Way, surfaces: Surfaces, noise: np.float32, found: FloatArray) -> None:
    (now, earlier), (turn, shift), (inverse, nearest, farthest) = pair, way, surfaces
    rows, columns = inverse.shape
    lights, below = earlier.ravel(), np.uint32(columns)
    last_column, last_row = np.float32(columns - 1), np.float32(earlier.shape[0] - 1)
    for row in range(rows):
        for column in range(columns):
            found[row, column] = inverse[row, column]
            near, far = nearest[row, column], farthest[row, column]
            if near - far <= _EDGE * near or not REACH <= row < rows - REACH:
                continue
            if not REACH <= column < columns - REACH:
                continue
            least = _NONE
            for choice in range(3):
                at = inverse[row, column] if choice == 0 else (near if choice == 1 else far)
                left = _ZERO
                for number in range((2 * REACH + 1) ** 2):
                    v_px = row - REACH + number // (2 * REACH + 1)
                    u_px = column - REACH + number % (2 * REACH + 1)
                    x, y = np.float32(u_px), np.float32(v_px)
                    z = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] + shift[2] * at
                    u = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] + shift[0] * at
                    v = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] + shift[1] * at
                    closer = _ONE / max(z, LEAST_DEPTH)
                    u, v = u * closer, v * closer
                    if not (u >= 0 and v >= 0 and u < last_column and v < last_row):
                        left = _NONE
                        break
                    left_px, top = np.int32(u), np.int32(v)
                    u, v = u - np.float32(left_px), v - np.float32(top)
                    first = np.uint32(top * np.int32(columns) + left_px)
                    second, third = first + np.uint32(1), first + below
                    upper = lights[first] + (lights[second] - lights[first]) * u
                    lower = lights[third + np.uint32(1)] - lights[third]
                    lower = lights[third] + lower * u
                    difference = upper + (lower - upper) * v - now[v_px, u_px]
                    left += min(difference * difference, _MOST) * _SHARE
                if choice == 0:
                    least = left
                elif left < _NONE and left * _BETTER + _TWO * noise * noise < least:
                    least, found[row, column] = left, at


# Fills a map of the inverse depth that an earlier frame suits best, of three at every pixel beside
# an edge; see `settled`.
settle = Compiled(_loop, settle_plain)
