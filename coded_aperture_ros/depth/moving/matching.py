"""How two frames match along every pixel's line of sight, at inverse depths around one."""

import math

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.fast_math import CompiledMath, exponential
from coded_aperture_ros.depth.moving.fusion_plain import Maps
from coded_aperture_ros.depth.moving.geometry import LEAST_DEPTH, Way
from coded_aperture_ros.depth.moving.matching_plain import (
    FARTHEST,
    INDEPENDENT,
    LEAST_INVERSE,
    LEAST_PX_PER,
    LEAST_STEP_FROM,
    LOOSER,
    MISFIT_SCALE,
    MOST_CONFIDENCE,
    SHIFT_PX,
    STEP_PX,
    TOLERANCE,
    Pair,
    Products,
    Scales,
    compare_plain,
    differ_plain,
    judge_plain,
)

_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_TINY = np.float32(1e-9)
_FARTHEST, _LEAST_FROM = np.float32(FARTHEST), np.float32(LEAST_STEP_FROM)
_STEP_PX, _LEAST_PX_PER = np.float32(STEP_PX), np.float32(LEAST_PX_PER)
_INDEPENDENT, _NOISY_SLOPE = np.float32(INDEPENDENT), np.float32(0.5 / STEP_PX**2)
_LOOSER, _TOLERANCE = np.float32(LOOSER), np.float32(TOLERANCE)
_EXPLAINED, _FALL = np.float32(SHIFT_PX**2), np.float32(-1 / MISFIT_SCALE)
_MOST, _LEAST_INVERSE = np.float32(MOST_CONFIDENCE), np.float32(LEAST_INVERSE)
_LEAST_SQUARES, _LEAST_INFORMATION = np.float32(1e-9), np.float32(1e-6)


def _compare_loop(
    pair: Pair, way: Way, inverse: FloatArray, scales: Scales, products: Products
) -> None:
    (now, earlier), (turn, shift), (px_pers, steps) = pair, way, scales
    squares, covaried, left, outside = products
    rows, columns = inverse.shape
    # Unsigned numbers of pixels: those that may be negative are looked up more slowly.
    lights, below = earlier.ravel(), np.uint32(columns)
    last_column, last_row = np.float32(columns - 1), np.float32(earlier.shape[0] - 1)
    for row in range(rows):
        of_row = turn[:, 1] * np.float32(row) + turn[:, 2]
        upper_row, lower_row = max(row - 1, 0), min(row + 1, rows - 1)
        for column in range(columns):
            across, middle = np.float32(column), inverse[row, column]
            x, y = turn[0, 0] * across + of_row[0], turn[1, 0] * across + of_row[1]
            z = turn[2, 0] * across + of_row[2]
            near = _ONE / max(z + shift[2] * middle, LEAST_DEPTH)
            along = shift[0] * z - shift[2] * x, shift[1] * z - shift[2] * y
            length = math.sqrt(along[0] * along[0] + along[1] * along[1]) + _TINY
            px_per = max(length * near * near, _LEAST_PX_PER)
            step = min(_STEP_PX / px_per, _FARTHEST * max(middle, _LEAST_FROM))
            left_column = max(column - 1, 0)
            right_column = min(column + 1, columns - 1)
            slope = along[0] * (now[row, right_column] - now[row, left_column])
            slope += along[1] * (now[lower_row, column] - now[upper_row, column])
            slope /= _TWO * length
            u, v = (x + shift[0] * middle) * near, (y + shift[1] * middle) * near
            inside = u >= 0 and v >= 0 and u < last_column and v < last_row
            if not inside:  # any pixel that there is
                u = v = _ZERO
            u_px, v_px = np.int32(u), np.int32(v)
            u, v = u - np.float32(u_px), v - np.float32(v_px)
            first = np.uint32(v_px * np.int32(columns) + u_px)
            second, third = first + np.uint32(1), first + below
            upper = lights[first] + (lights[second] - lights[first]) * u
            lower = lights[third + np.uint32(1)] - lights[third]
            lower = lights[third] + lower * u
            difference = upper + (lower - upper) * v - now[row, column]
            if not inside:
                slope = difference = _ZERO
            px_pers[row, column], steps[row, column] = px_per, step
            squares[row, column], covaried[row, column] = slope * slope, slope * difference
            left[row, column], outside[row, column] = difference * difference, not inside


def _differ_loop(
    pair: Pair, way: Way, every: int, inverse: FloatArray, found: tuple[FloatArray, FloatArray]
) -> None:
    (now, earlier), (turn, shift), (difference, outside) = pair, way, found
    rows, columns = earlier.shape
    last_column, last_row = np.float32(columns - 1), np.float32(rows - 1)
    for i in range(inverse.shape[0]):
        for j in range(inverse.shape[1]):
            row, column, at = i * every, j * every, inverse[i, j]
            z = turn[2, 0] * column + turn[2, 1] * row + turn[2, 2] + shift[2] * at
            near = _ONE / max(z, LEAST_DEPTH)
            u = turn[0, 0] * column + turn[0, 1] * row + turn[0, 2] + shift[0] * at
            v = turn[1, 0] * column + turn[1, 1] * row + turn[1, 2] + shift[1] * at
            u, v = u * near, v * near
            difference[i, j], outside[i, j] = 0, 1
            if u >= 0 and v >= 0 and u < last_column and v < last_row:
                left, top = int(u), int(v)
                u, v = u - left, v - top
                upper = earlier[top, left] * (_ONE - u) + earlier[top, left + 1] * u
                lower = earlier[top + 1, left] * (_ONE - u) + earlier[top + 1, left + 1] * u
                difference[i, j] = upper * (_ONE - v) + lower * v - now[i, j]
                outside[i, j] = 0


def _judge_loop(
    means: Products,
    scales: Scales,
    believed: tuple[FloatArray, FloatArray],
    limits: tuple[np.float32, np.float32],
    found: Maps,
) -> None:
    (squares, covaried, left, hidden), (px_pers, steps) = means, scales
    (believed_inverse, believed_variance), (noise, finest_px) = believed, limits
    inverse, variance, confidence = found
    noise_variance, finest = noise * noise, finest_px * finest_px
    for row in range(inverse.shape[0]):
        for column in range(inverse.shape[1]):
            square, both = squares[row, column], covaried[row, column]
            px_per, step = px_pers[row, column], steps[row, column]
            before = believed_inverse[row, column]
            change = -both / (max(square, _LEAST_SQUARES) * px_per)
            change = min(max(change, -step), step)
            # Noise has slopes, too.
            told = max(square - noise_variance * _NOISY_SLOPE, _ZERO)
            told *= _INDEPENDENT / noise_variance
            told /= _ONE + told * finest
            information = told * px_per * px_per
            tolerated = (_TOLERANCE * before) ** 2
            hold = _ONE / (_LOOSER * believed_variance[row, column] + tolerated)
            change *= information / (information + hold)
            after = max(before + change, _LEAST_INVERSE)
            moved_px = change * px_per
            still = left[row, column] + moved_px * (_TWO * both + moved_px * square)
            excess = max(still, _ZERO) / (_TWO * noise_variance + _EXPLAINED * square)
            spread = _ONE / max(information, _LEAST_INFORMATION)
            tolerated = (_TOLERANCE * after) ** 2
            trust = _MOST * exponential(_FALL * max(excess - _ONE, _ZERO))
            trust *= (_ONE - hidden[row, column]) * tolerated / (tolerated + spread)
            inverse[row, column], variance[row, column] = after, spread
            confidence[row, column] = trust


# Fills maps of what two frames, of which the earlier one is seen along the lines of sight, have in
# common near inverse depths: the scales of every pixel, and the products of slope and difference.
compare = Compiled(_compare_loop, compare_plain)
# Fills maps of the difference at inverse depths, and 1 where the earlier frame does not show it.
differ = Compiled(_differ_loop, differ_plain)
# Fills maps of a belief by such products, averaged over windows.
judge = CompiledMath(_judge_loop, judge_plain)
