"""Depth by parallax: where a frame has to be for an earlier one to look the same.

Near the focus, blur tells least and parallax most. The scale is that of the motion: of the lens, if
the motion was found by depth from this lens, else of the robot's pose.
"""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.depth.moving.belief import Belief, exposure_ratio
from coded_aperture_ros.depth.moving.geometry import Pinhole, Transfer

# Window within which the depth is one, px of the map, and how many of its pixels tell something of
# their own.
_WINDOW_PX = 9
_INDEPENDENT = 0.3 * _WINDOW_PX**2
# Step to either side along the line of sight, px of parallax, of which the best match is found: a
# second search from there followed noise, and brought half as much.
_STEP_PX = 1.0
# No match is better than this, px, as blur changes from place to place; nor is it where landmarks
# fit the motion worse than expected.
_FINEST_PX = 0.3
# Least standard deviation of the difference of two frames, in square roots of light.
_LEAST_NOISE = 0.001
# What was believed before holds the search as if it were four times as uncertain, and 5 % at least.
_LOOSER, _TOLERANCE = 4.0, 0.05
# Differences that a shift of this much would explain are no misfit, px; and how fast trust falls
# with the misfit, and the most there is.
_SHIFT_PX, _MISFIT_SCALE, _MOST_CONFIDENCE = 0.25, 2.0, 0.9
# Surfaces that stand before others are found by trying the nearest and farthest depth around, px;
# another depth is taken if it leaves so much less.
_AROUND_PX, _BETTER = 13, 1.5
_LEAST_INVERSE = np.float32(1e-3)
# Of how many rows and columns one is enough to choose a surface.
_SPARSE = 2


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """A past frame for comparison: square roots of its light, and where its camera was.

    Attributes
    ----------
    roots : ndarray, float32 [rows, columns]
        Square roots of smoothed linear light.
    pose : ndarray, float64 [4, 4]
        Turns points of its camera into those of the world.
    """

    roots: FloatArray
    pose: DoubleArray


def by_parallax(
    now: FloatArray,
    seen: Seen,
    pose: DoubleArray,
    view: Pinhole,
    belief: Belief,
    noise: float = 0.0,
    misfit: float = 1.0,
) -> Belief:
    """Belief by parallax alone; confidence 0 where nothing can be told.

    Parameters
    ----------
    now : ndarray, float32 [rows, columns]
        Square roots of the present frame's smoothed light.
    seen : Seen
        The frame to compare with.
    pose : ndarray, float64 [4, 4]
        Of the present camera.
    view : Pinhole
    belief : Belief
        From where the search begins.
    noise : float
        Standard deviation of `now`'s noise.
    misfit : float
        Of the landmarks, by the motion; see `Motion`.

    References
    ----------
    B. D. Lucas and T. Kanade, An iterative image registration technique, IJCAI 1981; along the
    epipolar line, by inverse depth.
    """
    motion = np.linalg.inv(seen.pose) @ pose
    inverse = np.maximum(belief.inverse, _LEAST_INVERSE)
    now = now / _brighter(_Line(now, seen, view, motion, noise, _SPARSE), inverse)
    noise = max(2**0.5 * noise, _LEAST_NOISE)
    inverse = _likeliest_around(_Line(now, seen, view, motion, noise, _SPARSE), inverse)
    line = _Line(now, seen, view, motion, noise)
    match = line.match(inverse, _FINEST_PX * max(misfit, 1.0) ** 0.5)
    hold = 1 / (_LOOSER * belief.variance + np.square(_TOLERANCE * inverse))
    change = match.information * match.change / (match.information + hold)
    found = np.maximum(inverse + change, _LEAST_INVERSE)
    left = match.left_after(change)
    excess = left / (2 * line.noise**2 + np.float32(_SHIFT_PX**2) * match.slope) - 1
    variance = np.asarray(1 / np.maximum(match.information, np.float32(1e-6)), np.float32)
    tolerated = np.square(_TOLERANCE * found)
    confidence = _MOST_CONFIDENCE * np.exp(-np.maximum(excess, 0) / _MISFIT_SCALE)
    confidence *= (1 - match.hidden) * tolerated / (tolerated + variance)
    return Belief(np.asarray(found, np.float32), variance, np.asarray(confidence, np.float32))


def _brighter(line: "_Line", inverse: FloatArray) -> np.float32:
    """By how much the present frame is brighter than the earlier one, in square roots of light."""
    shown = line.shown(inverse[::_SPARSE, ::_SPARSE])
    inside = shown >= 0
    return exposure_ratio(line.now[inside], shown[inside])


def _likeliest_around(line: "_Line", inverse: FloatArray) -> FloatArray:
    """Inverse depth of the surface, of those around a pixel, that suits best.

    On every second row and column: surfaces are larger than that.
    """
    around = np.ones((_AROUND_PX // _SPARSE,) * 2, np.uint8)
    some = np.ascontiguousarray(inverse[::_SPARSE, ::_SPARSE])
    least, _ = line.left_over(some)
    found = some
    for other in (cv2.dilate(some, around), cv2.erode(some, around)):
        left, hidden = line.left_over(other)
        better = (left * _BETTER + 2 * line.noise**2 < least) & (hidden == 0)
        found, least = np.where(better, other, found), np.where(better, left, least)
    changed = (found != some).astype(np.uint8)
    if not changed.any():
        return inverse
    size = inverse.shape[::-1]
    large, where = (
        cv2.resize(of, size, interpolation=cv2.INTER_NEAREST) for of in (found, changed)
    )
    return np.where(where > 0, large, inverse)


@dataclasses.dataclass(frozen=True, eq=False)
class _Match:
    """How two frames match along the lines of sight; all float32 [rows, columns].

    Attributes
    ----------
    change : ndarray
        Of the inverse depth, to where they match best, 1/m.
    information : ndarray
        Inverse of its variance.
    slope : ndarray
        Mean square of the change of the earlier frame along the line, per px.
    hidden : ndarray
        Share of the window that is not in the earlier frame.
    """

    change: FloatArray
    information: FloatArray
    slope: FloatArray
    hidden: FloatArray
    _px_per: FloatArray
    _left: FloatArray
    _covaried: FloatArray

    def left_after(self, change: FloatArray) -> FloatArray:
        """Mean squared difference that a change of the inverse depth leaves."""
        moved_px = change * self._px_per
        left = self._left + moved_px * (2 * self._covaried + moved_px * self.slope)
        return np.asarray(np.maximum(left, 0), np.float32)


class _Line:
    """Differences of two frames, for inverse depths along every pixel's line of sight.

    Of every pixel, or of some rows and columns.
    """

    def __init__(
        self,
        now: FloatArray,
        seen: Seen,
        view: Pinhole,
        motion: DoubleArray,
        noise: float,
        every: int = 1,
    ) -> None:
        self.noise = np.float32(noise)
        self.now, self._roots = now[::every, ::every], seen.roots
        self._transfer = Transfer(view, motion, every)
        self._window = (_WINDOW_PX // every // 2 * 2 + 1,) * 2

    def left_over(self, inverse: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean squared difference in the window, and the share of it that is outside."""
        shown = self.shown(inverse)
        outside = shown < 0
        difference = np.where(outside, 0, shown - self.now)
        return self._mean(difference * difference), self._mean(outside)

    def match(self, inverse: FloatArray, finest_px: float) -> _Match:
        """Match near inverse depths, of which none is better than so many px."""
        px_per = np.maximum(self._transfer.parallax(inverse), np.float32(1e-2))
        farthest = np.float32(0.3) * np.maximum(inverse, np.float32(0.05))
        step = np.minimum(_STEP_PX / px_per, farthest)
        before, here, after = (self.shown(inverse + sign * step) for sign in (-1, 0, 1))
        inside = np.minimum(np.minimum(before, here), after) >= 0
        slope = np.where(inside, (after - before) / (2 * step * px_per), 0)
        difference = np.where(inside, here - self.now, 0)
        squares, covaried, left = (
            self._mean(product)
            for product in (slope * slope, slope * difference, difference * difference)
        )
        change = -covaried / (np.maximum(squares, np.float32(1e-9)) * px_per)
        # Noise has slopes, too.
        told = np.maximum(squares - self.noise**2 / np.float32(2 * _STEP_PX**2), 0)
        told *= np.float32(_INDEPENDENT) / self.noise**2
        told /= 1 + told * np.float32(finest_px**2)
        information = told * np.square(px_per)
        change = np.clip(change, -step, step)
        hidden = self._mean(~inside)
        return _Match(change, information, squares, hidden, px_per, left, covaried)

    def shown(self, inverse: FloatArray) -> FloatArray:
        """The earlier frame where each pixel's point is in it; -1 outside of it."""
        at = self._transfer.columns_rows(inverse)
        shown: FloatArray = cv2.remap(
            self._roots, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1.0
        )
        return shown

    def _mean(self, values: FloatArray | BoolArray) -> FloatArray:
        mean: FloatArray = cv2.blur(np.asarray(values, np.float32), self._window)
        return mean
