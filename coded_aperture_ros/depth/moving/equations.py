"""Equations for the motion between two frames, by points whose depth is believed."""

import math

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.depth.moving.equations_plain import (
    LEAST_DEPTH,
    POINT_PX,
    ROBUST,
    Pair,
    Points,
    add_equations_plain,
)


def _loop(
    points: Points,
    pixels: DoubleArray,
    view: tuple[Pair, Pair],
    matrix: DoubleArray,
    found: tuple[DoubleArray, DoubleArray],
) -> None:
    (rays, inverses, variances), (focal_px, centre), (squares, system) = points, view, found
    system[:] = 0
    slopes, along = np.empty((2, 6)), np.empty(2)
    for i in range(len(inverses)):
        ray, inverse = rays[i], inverses[i]
        point = matrix[:3, 0] * ray[0] + matrix[:3, 1] * ray[1] + matrix[:3, 2]
        point += inverse * matrix[:3, 3]
        z = max(point[2], LEAST_DEPTH)
        x, y, near = point[0] / z, point[1] / z, inverse / z
        error = np.empty(2)
        for axis in range(2):
            at, focal = (x, y)[axis], focal_px[axis]
            error[axis] = pixels[i, axis] - at * focal - centre[axis]
            along[axis] = focal * (matrix[axis, 3] - at * matrix[2, 3]) / z
            slopes[axis, axis], slopes[axis, 1 - axis] = focal * near, 0.0
            slopes[axis, 2] = -focal * at * near
            sign = 1.0 if axis == 0 else -1.0
            slopes[axis, 3 + axis] = -sign * focal * x * y
            slopes[axis, 4 - axis] = sign * focal * (1 + at * at)
            slopes[axis, 5] = -sign * focal * (y if axis == 0 else x)
        length = math.hypot(along[0], along[1])
        line = (along[0] / length, along[1] / length) if length > 0 else (1.0, 0.0)
        deviation = math.sqrt(POINT_PX**2 + variances[i] * length * length)
        first = (error[0] * line[0] + error[1] * line[1]) / deviation
        second = (error[1] * line[0] - error[0] * line[1]) / POINT_PX
        squares[i] = first * first + second * second
        # Outliers count less (Cauchy's weights).
        weight = 1 / (1 + squares[i] / ROBUST**2)
        by_first = (slopes[0] * line[0] + slopes[1] * line[1]) / deviation
        by_second = (slopes[1] * line[0] - slopes[0] * line[1]) / POINT_PX
        for j in range(6):
            system[6, j] += weight * (by_first[j] * first + by_second[j] * second)
            for k in range(6):
                information = by_first[j] * by_first[k] + by_second[j] * by_second[k]
                system[j, k] += weight * information


# Fills the squared errors [n] of points, normalised along and across their epipolar lines, under a
# motion [4, 4], and sets the normal equations [7, 6] of its change by translation and rotation:
# information, and in the last row its pull.
add_equations = Compiled(_loop, add_equations_plain)
