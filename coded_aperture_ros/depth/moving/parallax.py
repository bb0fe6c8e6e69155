"""Depth by parallax: where a frame has to be for an earlier one to look the same.

Near the focus, blur tells least and parallax most. The scale is that of the motion: of the lens, if
the motion was found by depth from this lens, else of the robot's pose.
"""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.depth.moving.belief import Belief
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
_OUTSIDE = np.float32(-1)


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
    finest_px = _FINEST_PX * max(misfit, 1.0) ** 0.5
    limits = max(2**0.5 * noise, _LEAST_NOISE), finest_px
    line = _Line(now, seen, view, np.linalg.inv(seen.pose) @ pose, limits)
    inverse = line.likeliest_around(np.maximum(belief.inverse, _LEAST_INVERSE))
    change, information, slope = line.improvement(inverse)
    hold = 1 / (_LOOSER * belief.variance + np.square(_TOLERANCE * inverse))
    found = np.maximum(inverse + information * change / (information + hold), _LEAST_INVERSE)
    inverse = np.asarray(found, np.float32)
    left, hidden = line.left_over(inverse)
    excess = left / (2 * line.noise**2 + np.float32(_SHIFT_PX**2) * slope) - 1
    variance = np.asarray(1 / np.maximum(information, np.float32(1e-6)), np.float32)
    tolerated = np.square(_TOLERANCE * inverse)
    confidence = _MOST_CONFIDENCE * np.exp(-np.maximum(excess, 0) / _MISFIT_SCALE)
    confidence *= (1 - hidden) * tolerated / (tolerated + variance)
    return Belief(inverse, variance, np.asarray(confidence, np.float32))


class _Line:
    """Differences of two frames, for inverse depths along every pixel's line of sight."""

    def __init__(
        self,
        now: FloatArray,
        seen: Seen,
        view: Pinhole,
        motion: DoubleArray,
        limits: tuple[float, float],
    ) -> None:
        self.noise, self._finest_px = map(np.float32, limits)
        self._now, self._roots = now, seen.roots
        self._transfer = Transfer(view, motion)

    def _shown(self, inverse: FloatArray) -> FloatArray:
        """The earlier frame where each pixel's point is in it; -1 outside of it."""
        at = self._transfer.columns_rows(inverse)
        shown: FloatArray = cv2.remap(
            self._roots, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1.0
        )
        return shown

    def left_over(self, inverse: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean squared difference in the window, and the share of it that is outside."""
        shown = self._shown(inverse)
        outside = shown < 0
        difference = np.where(outside, 0, shown - self._now)
        left = _window_mean(difference * difference)
        return left, _window_mean(outside.astype(np.float32))

    def likeliest_around(self, inverse: FloatArray) -> FloatArray:
        """Inverse depth of the surface, of those around a pixel, that suits best."""
        around = np.ones((_AROUND_PX, _AROUND_PX), np.uint8)
        least, _ = self.left_over(inverse)
        found = inverse
        for other in (cv2.dilate(inverse, around), cv2.erode(inverse, around)):
            left, hidden = self.left_over(other)
            better = (left * _BETTER + 2 * self.noise**2 < least) & (hidden == 0)
            found, least = np.where(better, other, found), np.where(better, left, least)
        return np.asarray(found, np.float32)

    def improvement(self, inverse: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Change of the inverse depth that suits best, the inverse of its variance, and slope.

        The slope is the mean square of the change of the earlier frame along the line, per px.
        """
        px_per = np.maximum(self._transfer.parallax(inverse), np.float32(1e-2))
        step = np.minimum(
            _STEP_PX / px_per, np.float32(0.3) * np.maximum(inverse, np.float32(0.05))
        )
        before, here, after = (self._shown(inverse + sign * step) for sign in (-1, 0, 1))
        inside = np.minimum(np.minimum(before, here), after) >= 0
        slope = np.where(inside, (after - before) / (2 * step * px_per), 0)
        difference = np.where(inside, here - self._now, 0)
        squares = _window_mean(slope * slope)
        change_px = -_window_mean(slope * difference) / np.maximum(squares, np.float32(1e-9))
        # Noise has slopes, too.
        told = np.maximum(squares - self.noise**2 / np.float32(2 * _STEP_PX**2), 0)
        told *= np.float32(_INDEPENDENT) / self.noise**2
        told /= 1 + told * self._finest_px**2
        return np.clip(change_px / px_per, -step, step), told * np.square(px_per), squares


def _window_mean(values: FloatArray) -> FloatArray:
    mean: FloatArray = cv2.blur(np.asarray(values, np.float32), (_WINDOW_PX, _WINDOW_PX))
    return mean
