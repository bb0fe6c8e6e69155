"""Depth by parallax: where a frame has to be for an earlier one to look the same.

Near the focus, blur tells least and parallax most. The scale is that of the motion: of the lens, if
the motion was found by depth from this lens, else of the robot's pose.
"""

import dataclasses
import math

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.depth.moving.belief import Belief
from coded_aperture_ros.depth.moving.carrying import exposure_ratio
from coded_aperture_ros.depth.moving.edges import settled
from coded_aperture_ros.depth.moving.geometry import Pinhole, Way
from coded_aperture_ros.depth.moving.matching import compare, differ, judge
from coded_aperture_ros.depth.moving.matching_plain import LEAST_INVERSE, WINDOW_PX
from coded_aperture_ros.depth.moving.uncertainty import carries, deviation_px

# No match is better than this, px, as blur changes from place to place; nor is it where landmarks
# fit the motion worse than expected, or the pose is stated to be less certain.
_FINEST_PX = 0.3
# Least standard deviation of the difference of two frames, in square roots of light.
_LEAST_NOISE = 0.001
# Surfaces that stand before others are found by trying the nearest and farthest depth around, px;
# another depth is taken if it leaves so much less.
_AROUND_PX, _BETTER = 13, 1.5
# Of how many rows and columns one is enough to choose a surface, and of these for a median.
_SPARSE, _OF_MEDIAN = 2, 8


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """A past frame for comparison: square roots of its light, and where its camera was.

    Attributes
    ----------
    roots : ndarray, float32 [rows, columns]
        Square roots of smoothed linear light.
    pose : ndarray, float64 [4, 4]
        Turns points of its camera into those of the world.
    covariance : ndarray, float64 [6, 6]
        Of the motion since, as stated poses have it; 0 where nothing is stated.
    """

    roots: FloatArray
    pose: DoubleArray
    covariance: DoubleArray = dataclasses.field(default_factory=lambda: np.zeros((6, 6)))

    def carried(self, motion: DoubleArray, covariance: DoubleArray) -> "Seen":
        """The frame after one more motion [4, 4], with a covariance [6, 6]."""
        carry = carries(motion)
        return dataclasses.replace(self, covariance=carry @ self.covariance @ carry.T + covariance)


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
    shape, way = view.shape, view.way(np.linalg.inv(seen.pose) @ pose)
    off_px = deviation_px(seen.covariance, view, belief.middle)
    noise = max(2**0.5 * noise, _LEAST_NOISE)
    inverse = np.maximum(belief.inverse, np.float32(LEAST_INVERSE))
    some = _Sparse(np.ascontiguousarray(now[::_SPARSE, ::_SPARSE]), seen.roots, way)
    some_inverse = np.ascontiguousarray(inverse[::_SPARSE, ::_SPARSE])
    brighter = some.brighter(some_inverse)
    some = dataclasses.replace(some, now=some.now / brighter)
    now, inverse = now / brighter, some.likeliest_around(some_inverse, inverse, noise)
    products, scales, found = (np.empty((count, *shape), np.float32) for count in (4, 2, 3))
    compare((now, seen.roots), way, inverse, tuple(scales), tuple(products))
    means = tuple(cv2.blur(product, (WINDOW_PX, WINDOW_PX)) for product in products)
    finest_px = math.hypot(_FINEST_PX * max(misfit, 1.0) ** 0.5, off_px)
    limits = np.float32(noise), np.float32(finest_px)
    variance = np.ascontiguousarray(belief.variance)
    judge(means, tuple(scales), (inverse, variance), limits, tuple(found))
    return Belief(*found)


def settled_at_edges(
    inverse: FloatArray,
    now: FloatArray,
    seen: Seen,
    pose: DoubleArray,
    view: Pinhole,
    noise: float = 0.0,
) -> FloatArray:
    """Inverse depth [rows, columns], at edges that of the surface which suits the earlier frame.

    The other arguments are those of `by_parallax`.
    """
    way = view.way(np.linalg.inv(seen.pose) @ pose)
    some = _Sparse(np.ascontiguousarray(now[::_SPARSE, ::_SPARSE]), seen.roots, way)
    now = now / some.brighter(np.ascontiguousarray(inverse[::_SPARSE, ::_SPARSE]))
    return settled(inverse, now, seen.roots, way, max(2**0.5 * noise, _LEAST_NOISE))


@dataclasses.dataclass(frozen=True, eq=False)
class _Sparse:
    """Some rows and columns of the present frame, to compare with an earlier one.

    Attributes
    ----------
    now : ndarray, float32 [rows / 2, columns / 2]
    earlier : ndarray, float32 [rows, columns]
    way : Way
        From the present view to the earlier one.
    """

    now: FloatArray
    earlier: FloatArray
    way: Way

    def brighter(self, inverse: FloatArray) -> np.float32:
        """By how much the present frame is brighter than the earlier one."""
        difference, outside = self._difference(inverse)
        inside = outside == 0
        now, then = (of[inside][::_OF_MEDIAN] for of in (self.now, self.now + difference))
        return exposure_ratio(now, then)

    def likeliest_around(self, inverse: FloatArray, of_all: FloatArray, noise: float) -> FloatArray:
        """Inverse depth of the surface, of those around a pixel, that suits best.

        By some rows and columns, `inverse`, of all: surfaces are larger than that.
        """
        around = np.ones((_AROUND_PX // _SPARSE,) * 2, np.uint8)
        found, (least, _) = inverse, self._left_over(inverse)
        for other in (cv2.dilate(inverse, around), cv2.erode(inverse, around)):
            left, hidden = self._left_over(other)
            better = (left * _BETTER + np.float32(2 * noise**2) < least) & (hidden == 0)
            found, least = np.where(better, other, found), np.where(better, left, least)
        changed = (found != inverse).astype(np.uint8)
        if not changed.any():
            return of_all
        size = of_all.shape[::-1]
        large, where = (
            cv2.resize(of, size, interpolation=cv2.INTER_NEAREST) for of in (found, changed)
        )
        return np.where(where > 0, large, of_all)

    def _left_over(self, inverse: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean squared difference in the window, and the share of it that is outside."""
        window = (WINDOW_PX // _SPARSE // 2 * 2 + 1,) * 2
        difference, outside = self._difference(inverse)
        return cv2.blur(difference * difference, window), cv2.blur(outside, window)

    def _difference(self, inverse: FloatArray) -> FloatArray:
        """Difference of the earlier frame, and where that does not show it [2, rows, columns]."""
        found = np.empty((2, *inverse.shape), np.float32)
        differ((self.now, self.earlier), self.way, _SPARSE, inverse, tuple(found))
        return found
