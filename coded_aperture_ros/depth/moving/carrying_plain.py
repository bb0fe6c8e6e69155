"""A belief carried to another view by NumPy, where there is no numba."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth.moving.fusion_plain import Maps
from coded_aperture_ros.depth.moving.geometry import LEAST_DEPTH, Way

# Variance that a step adds, as a share of the squared inverse depth: pixels are whole.
STEP_VARIANCE = 1e-4
# Brightness that may differ between two frames of the same point, as a share, and the darkness
# below which shares mean nothing, linear light.
LIGHT_SHARE = 0.15
DARK = 0.02
# What is nearer hides what is farther if it is at least so sure, as a share of the surest there.
HIDES = 0.7
LEAST_CONFIDENCE = 0.02
# Cracks between pixels that were carried apart are filled from around them, so surely.
CRACK_SHARE = 0.5
# Smoothed light of the past frame and of the present one [rows, columns].
Lights = tuple[FloatArray, FloatArray]
# Where pixels go [rows, columns]: the pixel, by its number, or -1, int32; how much nearer, and how
# surely, float32. And the surest of all that go to a pixel, float32 [pixels].
Buffers = tuple[NDArray[np.int32], FloatArray, FloatArray, FloatArray]
# Confidence that is left of one, by how much the present frame is brighter, and the variance that
# the step adds, as a share of the squared inverse depth.
Trust = tuple[np.float32, np.float32, np.float32]


def carry_plain(
    past: Maps, lights: Lights, way: Way, trust: Trust, buffers: Buffers, found: Maps
) -> None:
    """Form of `carry` for NumPy."""
    (was, now), (turn, shift), (keep, brighter, step_variance) = lights, way, trust
    inverse, variance, confidence = past
    rows, columns = inverse.shape
    at_row, at_column = np.indices(inverse.shape, np.float32)
    x, y, ratio = (
        row[0] * at_column + row[1] * at_row + row[2] + moved * inverse
        for row, moved in zip(turn, shift, strict=True)
    )
    nearer = 1 / np.maximum(ratio, np.float32(LEAST_DEPTH))
    column, row = (np.floor(each * nearer + np.float32(0.5)) for each in (x, y))
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    inside &= (ratio > LEAST_DEPTH) & (confidence > LEAST_CONFIDENCE)
    target = (row * columns + column)[inside].astype(np.intp)
    seen, nearer = now.ravel()[target], nearer[inside]
    differs = (was[inside] * brighter - seen) / (LIGHT_SHARE * (seen + DARK))
    sure = keep * confidence[inside] * np.exp(-0.5 * np.square(differs))
    surest = np.zeros(rows * columns, np.float32)
    np.maximum.at(surest, target, sure)
    stands = sure >= np.maximum(HIDES * surest[target], LEAST_CONFIDENCE)
    moved = inverse[inside]
    spread = (variance[inside] + step_variance * np.square(moved)) * np.square(nearer)
    target, moved, spread, sure = (
        values[stands] for values in (target, moved * nearer, spread, sure)
    )
    nearest = np.full(rows * columns, -1, np.float32)
    np.maximum.at(nearest, target, moved)
    first = moved == nearest[target]
    for values, there in zip(found, (moved, spread, sure), strict=True):
        values[:] = 0
        values.ravel()[target[first]] = there[first]


def fill_cracks_plain(found: Maps) -> None:
    """Form of `fill_cracks` for NumPy."""
    empty = found[2] == 0
    known = (~empty).astype(np.float32)
    share = np.maximum(cv2.blur(known, (3, 3)), np.float32(1e-6))
    for values in found:
        np.copyto(values, cv2.blur(values, (3, 3)) / share, where=empty)
    found[2][empty] *= CRACK_SHARE
