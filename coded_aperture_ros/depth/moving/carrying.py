"""A belief of a past frame, carried to where the present one sees it."""

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.fast_math import CompiledMath, exponential
from coded_aperture_ros.depth.moving.belief import Belief
from coded_aperture_ros.depth.moving.carrying_plain import (
    CRACK_SHARE,
    DARK,
    HIDES,
    LEAST_CONFIDENCE,
    LIGHT_SHARE,
    STEP_VARIANCE,
    Buffers,
    Lights,
    Trust,
    carry_plain,
    fill_cracks_plain,
)
from coded_aperture_ros.depth.moving.fusion_plain import Maps
from coded_aperture_ros.depth.moving.geometry import LEAST_DEPTH, Pinhole, Transfer, Way

# Of so many rows and columns one is enough for a median.
_SPARSE = 4
# Square root of 0.5 over the share: an exponential of the square is what light leaves of trust.
_STEEP = np.float32(0.5**0.5 / LIGHT_SHARE)
_DARK, _HIDES, _LEAST = np.float32(DARK), np.float32(HIDES), np.float32(LEAST_CONFIDENCE)
_CRACK_SHARE = np.float32(CRACK_SHARE)
_HALF = np.float32(0.5)


def carried(
    belief: Belief,
    light: FloatArray,
    now: FloatArray,
    view: Pinhole,
    motion: DoubleArray,
    keep: float,
    off_px: float = 0.0,
) -> Belief:
    """Belief of a past frame as the present one sees it; confidence 0 where nothing of it is.

    Parameters
    ----------
    belief : Belief
    light, now : ndarray, float32 [rows, columns]
        Smoothed brightness of the past frame and of the present one, linear light. Where it
        differs by more than the exposure, something else has come before it.
    view : Pinhole
        Of both frames.
    motion : ndarray, float64 [4, 4]
        Turns points of the past view into those of the present one.
    keep : float
        Confidence that is left of one, in [0, 1].
    off_px : float, optional
        Standard deviation of where points are after the motion, px, beyond what steps of landmarks
        and poses without a covariance are allowed.
    """
    shape = belief.inverse.shape
    way = view.way(motion)
    brighter = _brighter(belief, (light, now), way)
    found = np.empty((3, *shape), np.float32)
    buffers = (
        np.empty(shape, np.int32),
        np.empty(shape, np.float32),
        np.empty(shape, np.float32),
        np.zeros(light.size, np.float32),
    )
    # A pixel's number is rounded, which is off by the root of a twelfth.
    trust = np.float32(keep), brighter, np.float32(STEP_VARIANCE * (1 + 12 * off_px**2))
    carry(belief.maps, (light, now), way, trust, buffers, tuple(found))
    fill_cracks(tuple(found))
    return Belief(*found)


def _brighter(belief: Belief, lights: Lights, way: Way) -> np.float32:
    """By how much the present frame is brighter than the past one, at some of its pixels."""
    was, now = lights
    rows, columns = now.shape
    inverse, some = (of[::_SPARSE, ::_SPARSE] for of in (belief.inverse, was))
    column, row = Transfer(way, now.shape, _SPARSE).columns_rows(inverse)
    inside = (column > 0) & (column < columns - 1) & (row > 0) & (row < rows - 1)
    return exposure_ratio(now[row[inside].astype(int), column[inside].astype(int)], some[inside])


def exposure_ratio(now: FloatArray, then: FloatArray) -> np.float32:
    """By how much a frame is brighter than another, by the median of the same places.

    1 where there are none. Cameras change their exposure by themselves.
    """
    lit = then > DARK * DARK
    return np.float32(np.median(now[lit] / then[lit])) if lit.any() else np.float32(1)


def _loop(
    past: Maps, lights: Lights, way: Way, trust: Trust, buffers: Buffers, found: Maps
) -> None:
    (was, now), (turn, shift), (keep, brighter, step_variance) = lights, way, trust
    inverse, variance, confidence = past
    target, nearer, sure, surest = buffers
    found_inverse, found_variance, found_confidence = found
    rows, columns = inverse.shape
    for row in range(rows):
        for column in range(columns):
            target[row, column] = -1
            found_confidence[row, column] = 0
            if confidence[row, column] <= _LEAST:
                continue
            moved = inverse[row, column]
            ratio = turn[2, 0] * column + turn[2, 1] * row + turn[2, 2] + shift[2] * moved
            if ratio <= LEAST_DEPTH:
                continue
            near = 1 / ratio
            x = turn[0, 0] * column + turn[0, 1] * row + turn[0, 2] + shift[0] * moved
            y = turn[1, 0] * column + turn[1, 1] * row + turn[1, 2] + shift[1] * moved
            x, y = x * near + _HALF, y * near + _HALF
            if x < 0 or y < 0 or x >= columns or y >= rows:
                continue
            there = int(y), int(x)
            seen = now[there]
            differs = _STEEP * (was[row, column] * brighter - seen) / (seen + _DARK)
            left = keep * confidence[row, column] * exponential(-differs * differs)
            number = there[0] * columns + there[1]
            target[row, column] = number
            nearer[row, column], sure[row, column] = near, left
            surest[number] = max(surest[number], left)
    for row in range(rows):
        for column in range(columns):
            number = target[row, column]
            if number < 0:
                continue
            there = number // columns, number % columns
            left, near = sure[row, column], nearer[row, column]
            if left < max(_HIDES * surest[number], _LEAST):
                continue
            before = inverse[row, column]
            moved = before * near
            if found_confidence[there] == 0 or moved >= found_inverse[there]:
                spread = variance[row, column] + step_variance * before * before
                found_inverse[there], found_confidence[there] = moved, left
                found_variance[there] = spread * near * near


def _fill_loop(found: Maps) -> None:
    inverse, variance, confidence = found
    rows, columns = inverse.shape
    for row in range(rows):
        for column in range(columns):
            if confidence[row, column] != 0:
                continue
            count = 0
            sums = np.float32(0), np.float32(0), np.float32(0)
            for down in range(-1, 2):
                for across in range(-1, 2):
                    # Beyond the border it is as within.
                    at_row = row - down if not 0 <= row + down < rows else row + down
                    at_column = column + across
                    if not 0 <= at_column < columns:
                        at_column = column - across
                    if confidence[at_row, at_column] > 0:
                        count += 1
                        sums = (
                            sums[0] + inverse[at_row, at_column],
                            sums[1] + variance[at_row, at_column],
                            sums[2] + confidence[at_row, at_column],
                        )
            inverse[row, column] = sums[0] / max(count, 1)
            variance[row, column] = sums[1] / max(count, 1)
            # What has been filled is negative until all are.
            confidence[row, column] = -_CRACK_SHARE * sums[2] / max(count, 1)
    for row in range(rows):
        for column in range(columns):
            confidence[row, column] = abs(confidence[row, column])


# Fills maps of a past belief where the present frame sees it; see `carried`.
carry = CompiledMath(_loop, carry_plain)
# Fills single empty pixels of such maps by the mean around them.
fill_cracks = Compiled(_fill_loop, fill_cracks_plain)
