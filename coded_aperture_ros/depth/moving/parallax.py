"""Depth by parallax: where a frame has to be for an earlier one to look the same.

Near the focus, blur tells least and parallax most. The scale is that of the motion: of the lens, if
the motion was found by depth from this lens, else of the robot's pose.
"""

import dataclasses
import math
from itertools import pairwise

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.moving.belief import Belief
from coded_aperture_ros.depth.moving.carrying import exposure_ratio
from coded_aperture_ros.depth.moving.edges import settled
from coded_aperture_ros.depth.moving.fusion import fused
from coded_aperture_ros.depth.moving.fusion_plain import Maps
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
# What parallax tells agrees with what was believed; see `fused`.
_AGREEMENT = 0.8
# Matches of single pixels are off by noise: the median of squares of this side, which keeps edges,
# took a fifteenth of the mean error of walks.
_GRAIN_PX = 5
_EDGE_GRAIN_PX = 3
# Rows around others that change them, px, an even number: the surfaces around and their windows,
# windows of the match, medians, and edges.
_HALO_PX = 20
# Of how many rows and columns one is enough to choose a surface, and of these for a median.
_SPARSE, _OF_MEDIAN = 2, 3


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """A past frame for comparison: square roots of its light, and where its camera was.

    Attributes
    ----------
    roots : ndarray, float32 [rows, columns]
        Square roots of smoothed linear light.
    pose : ndarray, float64 [4, 4]
        Turns points of its camera into those of the world.
    covariance : ndarray, float64 [6, 6], or None
        Of the motion since, as stated poses have it; None: nothing is stated.
    """

    roots: FloatArray
    pose: DoubleArray
    covariance: DoubleArray | None = None

    def carried(self, motion: DoubleArray, covariance: DoubleArray | None) -> "Seen":
        """The frame after one more motion [4, 4], with a covariance [6, 6] if one is stated."""
        if self.covariance is not None:
            carry = carries(motion)
            before = carry @ self.covariance @ carry.T
            covariance = before if covariance is None else before + covariance
        return self if covariance is None else dataclasses.replace(self, covariance=covariance)


def with_parallax(
    belief: Belief,
    frames: tuple[FloatArray, Seen],
    pose: DoubleArray,
    view: Pinhole,
    errors: tuple[float, float],
    workers: Workers | None = None,
) -> Belief:
    """Belief with what parallax tells; beside edges that of the surface which suits it.

    Parameters
    ----------
    belief : Belief
        From where the search begins.
    frames : (ndarray, float32 [rows, columns], Seen)
        Square roots of the present frame's smoothed light, and the frame to compare with.
    pose : ndarray, float64 [4, 4]
        Of the present camera.
    view : Pinhole
    errors : (float, float)
        Standard deviation of the noise of the square roots, and the misfit of the landmarks by the
        motion; see `Motion`.
    workers : Workers, optional
        Each takes some of the rows.

    References
    ----------
    B. D. Lucas and T. Kanade, An iterative image registration technique, IJCAI 1981; along the
    epipolar line, by inverse depth.
    """
    now, seen = frames
    workers = workers or Workers()
    pair = Comparison.of(now, seen, pose, view, belief, errors)
    rows = now.shape[0]
    # Strips begin with an even row.
    ends = [2 * round(rows * part / workers.threads / 2) for part in range(workers.threads)]
    strips = list(pairwise((*ends, rows)))
    found = np.empty((3, *now.shape), np.float32)

    def improve(strip: tuple[int, int], _: int) -> None:
        begin, end = max(strip[0] - _HALO_PX, 0), min(strip[1] + _HALO_PX, rows)
        better = pair.of_rows(begin, end).improved(Belief(*(m[begin:end] for m in belief.maps)))
        found[:, strip[0] : strip[1]] = [m[strip[0] - begin : strip[1] - begin] for m in better]

    workers.each(improve, strips)
    return Belief(*found)


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """Rows of the present frame, to compare with an earlier one.

    Attributes
    ----------
    now : ndarray, float32 [rows, columns]
        As bright as the earlier one.
    earlier : ndarray, float32 [all rows, columns]
    way : Way
        From the rows of the present view to the earlier one.
    noise : float
        Standard deviation of the difference of both.
    finest_px : float
        No match is better than this.
    """

    now: FloatArray
    earlier: FloatArray
    way: Way
    noise: float
    finest_px: float

    @classmethod
    def of(
        cls,
        now: FloatArray,
        seen: Seen,
        pose: DoubleArray,
        view: Pinhole,
        belief: Belief,
        errors: tuple[float, float],
    ) -> "Comparison":
        """The arguments are those of `with_parallax`."""
        noise, misfit = errors
        stated = seen.covariance
        off_px = 0.0 if stated is None else deviation_px(stated, view, belief.middle)
        finest_px = math.hypot(_FINEST_PX * max(misfit, 1.0) ** 0.5, off_px)
        way = view.way(np.linalg.inv(seen.pose) @ pose)
        pair = cls(now, seen.roots, way, max(2**0.5 * noise, _LEAST_NOISE), finest_px)
        return dataclasses.replace(pair, now=now / pair._brighter(belief.inverse))

    def of_rows(self, begin: int, end: int) -> "Comparison":
        """Some of the rows."""
        turn, shift = self.way
        turn = turn.copy()
        turn[:, 2] += np.float32(begin) * turn[:, 1]
        return dataclasses.replace(self, now=self.now[begin:end], way=(turn, shift))

    def improved(self, belief: Belief) -> Maps:
        """Maps of the belief with what the earlier frame tells of it."""
        together = fused(belief, self.told(belief), _AGREEMENT)
        smooth = cv2.medianBlur(together.inverse, _GRAIN_PX)
        smooth = cv2.medianBlur(self.settled(smooth), _EDGE_GRAIN_PX)
        return smooth, together.variance, together.confidence

    def settled(self, inverse: FloatArray) -> FloatArray:
        """Inverse depth, at edges that of the surface which suits the earlier frame."""
        return settled(inverse, self.now, self.earlier, self.way, self.noise)

    def told(self, belief: Belief) -> Belief:
        """What parallax alone tells; confidence 0 where nothing can be told."""
        inverse = np.maximum(belief.inverse, np.float32(LEAST_INVERSE))
        inverse, shape = self._likeliest_around(inverse), inverse.shape
        products, scales, found = (np.empty((count, *shape), np.float32) for count in (4, 2, 3))
        compare((self.now, self.earlier), self.way, inverse, tuple(scales), tuple(products))
        means = tuple(cv2.blur(product, (WINDOW_PX, WINDOW_PX)) for product in products)
        limits = np.float32(self.noise), np.float32(self.finest_px)
        variance = np.ascontiguousarray(belief.variance)
        judge(means, tuple(scales), (inverse, variance), limits, tuple(found))
        return Belief(*found)

    def _brighter(self, inverse: FloatArray) -> np.float32:
        """By how much the present frame is brighter than the earlier one, by some pixels."""
        every = _SPARSE * _OF_MEDIAN
        some = np.ascontiguousarray(inverse[::every, ::every])
        now, (difference, outside) = self._differences(some, every)
        inside = outside == 0
        return exposure_ratio(now[inside], (now + difference)[inside])

    def _likeliest_around(self, inverse: FloatArray) -> FloatArray:
        """Inverse depth of the surface, of those around a pixel, that suits best.

        By some rows and columns of all: surfaces are larger than that.
        """
        around = np.ones((_AROUND_PX // _SPARSE,) * 2, np.uint8)
        some = np.ascontiguousarray(inverse[::_SPARSE, ::_SPARSE])
        found, (least, _) = some, self._left_over(some)
        for other in (cv2.dilate(some, around), cv2.erode(some, around)):
            left, hidden = self._left_over(other)
            better = (left * _BETTER + np.float32(2 * self.noise**2) < least) & (hidden == 0)
            found, least = np.where(better, other, found), np.where(better, left, least)
        changed = (found != some).astype(np.uint8)
        if not changed.any():
            return inverse
        size = inverse.shape[::-1]
        large, where = (
            cv2.resize(of, size, interpolation=cv2.INTER_NEAREST) for of in (found, changed)
        )
        return np.where(where > 0, large, inverse)

    def _left_over(self, inverse: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean squared difference in the window, and the share of it that is outside."""
        window = (WINDOW_PX // _SPARSE // 2 * 2 + 1,) * 2
        _, (difference, outside) = self._differences(inverse, _SPARSE)
        return cv2.blur(difference * difference, window), cv2.blur(outside, window)

    def _differences(self, inverse: FloatArray, every: int) -> tuple[FloatArray, FloatArray]:
        """Some pixels of the frame; and the difference of the earlier one [2, rows, columns].

        With it, 1 where the earlier one does not show them.
        """
        now = np.ascontiguousarray(self.now[::every, ::every])
        found = np.empty((2, *inverse.shape), np.float32)
        differ((now, self.earlier), self.way, every, inverse, tuple(found))
        return now, found
