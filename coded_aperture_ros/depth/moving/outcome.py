"""From levels to a belief of inverse depth, and back to a frame's maps."""

import math

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.moving.belief import Belief
from coded_aperture_ros.depth.moving.fusion_plain import Maps
from coded_aperture_ros.depth.moving.outcome_plain import (
    ENTRIES,
    PUBLISHED,
    SAME,
    Found,
    Tables,
    enlarge_plain,
    translate_plain,
)

# Least change of the inverse depth from level to level, as a share of the largest.
_LEAST_SLOPE = 0.05
_SAME, _ZERO, _HALF, _ONE = np.float32(SAME), np.float32(0), np.float32(0.5), np.float32(1)
_NEXT = np.uint32(1)


class Translation:
    """Belief of a frame's level, deviation and confidence, and the other way.

    Parameters
    ----------
    levels : Levels
        With depths in metres.
    """

    def __init__(self, levels: Levels) -> None:
        self._levels = levels
        # Inverse depth of every level on the axis, 1/m, [L].
        axial = np.nan_to_num(1 / np.asarray(levels.depths_m), nan=0.0)
        slopes = np.abs(np.gradient(axial))
        slopes = np.maximum(slopes, slopes.max() * _LEAST_SLOPE)
        ends, order = (axial.min(), axial.max()), np.argsort(axial)
        level_of = np.interp(np.linspace(*ends, ENTRIES), axial[order], order)
        density = (ENTRIES - 1) / max(ends[1] - ends[0], 1e-9)
        self._tables: Tables = (
            axial.astype(np.float32),
            slopes.astype(np.float32),
            level_of.astype(np.float32),
            PUBLISHED,
            (np.float32(ends[0]), np.float32(density)),
        )

    def belief(self, maps: Maps, size: Shape) -> tuple[FloatArray, Belief]:
        """Level and belief, in maps of a size, of level, deviation and confidence."""
        level, deviation, confidence = (_reduced(values, size) for values in maps)
        depth_m = self._levels.depth_m(level)
        assert depth_m is not None  # whoever made this has looked
        inverse = np.asarray(np.nan_to_num(1 / depth_m, nan=0.0), np.float32)
        variance = np.square(
            deviation * self._tables[1].take(np.rint(level).astype(np.int32), mode="clip")
        )
        return level, Belief(inverse, variance, confidence)

    def maps(self, level: FloatArray, small: tuple[FloatArray, Belief], found: Belief) -> Maps:
        """Level, deviation and confidence of a frame after its belief was changed.

        Parameters
        ----------
        level : ndarray, float32 [rows, columns]
            Of the frame alone. Edges stay where this frame has them, if little else has changed.
        small : (ndarray, Belief)
            Result of `belief`.
        found : Belief
            What is believed instead.
        """
        before, own = small
        new, deviation, confidence = np.empty((3, *before.shape), np.float32)
        same = np.empty(before.shape, np.bool_)
        changed = new, deviation, confidence, same
        translate(before, own.maps[0], found.maps, self._tables, changed)
        if level.shape == before.shape:
            return new, deviation, confidence
        results = np.empty((3, *level.shape), np.float32)
        enlarge(np.ascontiguousarray(level), before, changed, tuple(results))
        return results[0], results[1], results[2]


def _reduced(values: FloatArray, shape: Shape) -> FloatArray:
    """Values of the nearest pixels: means would mix what is before an edge and behind it."""
    if values.shape != shape:
        values = cv2.resize(values, shape[::-1], interpolation=cv2.INTER_NEAREST)
    return np.asarray(values, np.float32)


def _translate_loop(
    level: FloatArray, own: FloatArray, fused: Maps, tables: Tables, found: Found
) -> None:
    (inverse, variance, confidence), (axial, per_level, level_of, right, ends) = fused, tables
    first, density = ends
    new_level, deviation, published, same = found
    last, last_entry = np.int32(len(axial) - 1), np.int32(len(level_of) - 1)
    most = np.int32(len(right) - 1)
    for row in range(level.shape[0]):
        for column in range(level.shape[1]):
            now = min(max(level[row, column], _ZERO), np.float32(last))
            below = np.uint32(min(np.int32(now), last - 1))
            rise = axial[below + _NEXT] - axial[below]
            change = inverse[row, column] - own[row, column]
            at = axial[below] + (now - np.float32(below)) * rise + change - first
            at = min(max(at * density, _ZERO), np.float32(last_entry))
            entry = np.uint32(min(np.int32(at), last_entry - 1))
            rise = level_of[entry + _NEXT] - level_of[entry]
            new_level[row, column] = level_of[entry] + (at - np.float32(entry)) * rise
            slope = per_level[np.uint32(np.int32(now + _HALF))]
            deviation[row, column] = math.sqrt(variance[row, column]) / slope
            at = confidence[row, column] * np.float32(most)
            entry = np.uint32(min(np.int32(at), most - 1))
            rise = right[entry + _NEXT] - right[entry]
            published[row, column] = right[entry] + (at - np.float32(entry)) * rise
            larger = max(inverse[row, column], own[row, column])
            same[row, column] = abs(change) <= _SAME * larger


def _enlarge_loop(level: FloatArray, before: FloatArray, small: Found, found: Maps) -> None:
    (new, deviation, confidence, same), (new_level, new_deviation, new_confidence) = small, found
    rows, columns = level.shape
    small_rows, small_columns = before.shape
    shift = np.empty(small_columns, np.float32)
    share = np.empty(small_columns, np.float32)
    at_column = np.empty(columns, np.uint32)
    for column in range(columns):
        at_column[column] = column * small_columns // columns
    for row in range(rows):
        at_row = row * small_rows // rows
        for column in range(small_columns):
            share[column] = _ONE if same[at_row, column] else _ZERO
            shift[column] = new[at_row, column] - share[column] * before[at_row, column]
        for column in range(columns):
            at = at_column[column]
            new_level[row, column] = share[at] * level[row, column] + shift[at]
            new_deviation[row, column] = deviation[at_row, at]
            new_confidence[row, column] = confidence[at_row, at]


# Fills maps of the level, its deviation, the confidence that is published, and whether the depth is
# about the same, from the level and inverse depth by the frame and what is believed instead.
translate = Compiled(_translate_loop, translate_plain)
# Fills larger maps of level, deviation and confidence.
enlarge = Compiled(_enlarge_loop, enlarge_plain)
