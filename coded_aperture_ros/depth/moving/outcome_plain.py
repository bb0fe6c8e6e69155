"""A frame's maps after past frames were used, by NumPy, where there is no numba."""

from typing import Any

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.depth.moving.fusion_plain import Maps

# Where a depth is another than this frame's by more than this share, the edges are the memory's.
SAME = 0.05
# Entries of a table of levels by inverse depth.
ENTRIES = 4096
# Entries of the table of confidences, and below which two numbers of a log-odds are no more.
CONFIDENCES = 4096
_LEAST_ODDS = 1e-4
# Log-odds of a confidence that frames have agreed on, and measured probability of being within 5 %,
# the mean of fifteen walks through rooms made by chance (31 to 36, 44, 70 to 77), each 16 frames:
# frames have more errors in common than is reckoned with. In one of the rooms, of faint walls, it
# is a tenth of that.
_MEASURED = (
    (-9.0, 0.0002),
    (-3.0, 0.02),
    (-2.0, 0.32),
    (-1.3, 0.4),
    (-0.75, 0.47),
    (-0.3, 0.54),
    (0.1, 0.65),
    (0.95, 0.66),
    (1.5, 0.69),
    (2.1, 0.735),
    (2.7, 0.79),
    (3.4, 0.86),
    (4.2, 0.92),
    (5.05, 0.955),
    (6.0, 0.978),
    (7.0, 0.99),
    (8.0, 0.996),
    (9.2, 0.998),
)
# Inverse depth on the axis [L] and change of it from level to level [L], 1/m; level by inverse
# depth [ENTRIES], confidence that is published, by that of a belief [CONFIDENCES]; and the first
# inverse depth and entries by 1/m.
Tables = tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[np.float32, np.float32]]
# Level, its deviation, confidence, and whether the depth is about the same.
Found = tuple[FloatArray, FloatArray, FloatArray, BoolArray]


def published(confidence: FloatArray | DoubleArray) -> FloatArray:
    """Measured probability of an error of at most 5 %, in [0, 1], float32 [rows, columns].

    Examples
    --------
    >>> [f"{each:.2f}" for each in published(np.array([0.1, 0.5, 0.99]))]
    ['0.26', '0.62', '0.94']
    """
    limited: Any = np.clip(confidence, _LEAST_ODDS, 1 - _LEAST_ODDS)
    believed, right = np.array(_MEASURED).T
    right = np.interp(np.log(limited / (1 - limited)), believed, right)
    return np.asarray(right, np.float32)


PUBLISHED = published(np.linspace(0, 1, CONFIDENCES))


def translate_plain(
    level: FloatArray, own: FloatArray, fused: Maps, tables: Tables, found: Found
) -> None:
    """Form of `translate` for NumPy."""
    (inverse, variance, confidence), (axial, per_level, level_of, _, ends) = fused, tables
    first, density = ends
    change = inverse - own
    on_axis = np.interp(level, np.arange(len(axial)), axial) + change
    found[0][:] = np.interp((on_axis - first) * density, np.arange(ENTRIES), level_of)
    nearest = (level + np.float32(0.5)).astype(np.int32)
    found[1][:] = np.sqrt(variance) / per_level.take(nearest, mode="clip")
    found[2][:] = published(confidence)
    found[3][:] = np.abs(change) <= np.float32(SAME) * np.maximum(inverse, own)


def enlarge_plain(level: FloatArray, before: FloatArray, small: Found, found: Maps) -> None:
    """Form of `enlarge` for NumPy."""
    size = level.shape[::-1]
    old, new, deviation, confidence, same = (
        cv2.resize(of, size, interpolation=cv2.INTER_NEAREST)
        for of in (before, *small[:3], small[3].astype(np.uint8))
    )
    found[0][:] = np.where(same > 0, level + (new - old), new)
    found[1][:] = deviation
    found[2][:] = confidence
