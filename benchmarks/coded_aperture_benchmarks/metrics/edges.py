"""Depth edges: where they are, and how well those of an estimate follow the true ones."""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coded_aperture_ros.core.arrays import BoolArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.metrics.edges import EDGE_JUMP_PX, distance_to_px, lowest_and_highest

TOLERANCES_PX = (1, 2, 4)
# Flying pixels are between two surfaces that are so near, px, by more than this share.
_FLYING_AROUND_PX = 16
_FLYING_BY = 0.05


def occluding_contour(
    blur_size_px: NDArray[np.floating], jump_px: float = EDGE_JUMP_PX
) -> BoolArray:
    """Return the outermost pixels of nearer surfaces, one pixel wide at a sharp step.

    Parameters
    ----------
    blur_size_px : ndarray of float, shape [h, w]
        Signed blur size, which grows with depth; NaN where unknown.
    jump_px : float
        One of the eight neighbours is farther by more than this.
    """
    _, highest = lowest_and_highest(blur_size_px)
    with np.errstate(invalid="ignore"):
        return np.asarray(highest - blur_size_px > jump_px)


def flying_pixels(depth_m: NDArray[np.floating], truth_m: NDArray[np.floating]) -> BoolArray:
    """Return which depths lie between two surfaces, on neither of them [h, w].

    They are off by more than 5 %, and as much behind the nearest and before the farthest true depth
    within 16 px.

    Parameters
    ----------
    depth_m, truth_m : ndarray of float, shape [h, w]
        NaN where unknown.
    """
    known, side = np.isfinite(truth_m), 2 * _FLYING_AROUND_PX + 1
    nearest_m = ndimage.minimum_filter(np.where(known, truth_m, np.inf), side)
    farthest_m = ndimage.maximum_filter(np.where(known, truth_m, -np.inf), side)
    with np.errstate(invalid="ignore"):
        between = depth_m > (1 + _FLYING_BY) * nearest_m
        between &= depth_m < (1 - _FLYING_BY) * farthest_m
        return np.asarray(between & (np.abs(depth_m - truth_m) > _FLYING_BY * truth_m))


@dataclasses.dataclass(frozen=True)
class BoundaryMatch:
    """Contour pixels of an estimate and of the truth that lie near each other.

    Those of several frames add up.

    Attributes
    ----------
    estimated, estimated_near_true : int
        Contour pixels of the estimate, and how many lie near one of the truth.
    true, true_near_estimated : int
        The other way round.
    """

    estimated: int
    estimated_near_true: int
    true: int
    true_near_estimated: int

    @classmethod
    def of(
        cls,
        estimated_px: NDArray[np.floating],
        true_px: NDArray[np.floating],
        tolerances_px: tuple[int, ...] = TOLERANCES_PX,
    ) -> "dict[int, BoundaryMatch]":
        """Match the contours of two maps of signed blur sizes, for several tolerances.

        Contours of the estimate count only where the truth is known as far around as the largest
        tolerance: beside what is unknown the true contour may be hidden.

        Parameters
        ----------
        estimated_px, true_px : ndarray of float, shape [h, w]
            NaN where unknown.
        tolerances_px : tuple of int
            How far a contour pixel may be from the nearest one of the other map.

        Raises
        ------
        InputError
            If the shapes differ.
        """
        if estimated_px.shape != true_px.shape:
            raise InputError(
                f"expected maps of one shape, got {list(estimated_px.shape)} and "
                f"{list(true_px.shape)}"
            )
        unknown = ~np.isfinite(true_px)
        judged = distance_to_px(unknown) > max(tolerances_px)
        estimated, true = occluding_contour(estimated_px), occluding_contour(true_px)
        to_true = distance_to_px(true)[estimated & judged]
        to_estimated = distance_to_px(estimated)[true]
        return {
            tolerance: cls(
                to_true.size,
                int(np.count_nonzero(to_true <= tolerance)),
                to_estimated.size,
                int(np.count_nonzero(to_estimated <= tolerance)),
            )
            for tolerance in tolerances_px
        }

    def __add__(self, other: "BoundaryMatch") -> "BoundaryMatch":
        mine, others = dataclasses.astuple(self), dataclasses.astuple(other)
        return BoundaryMatch(*(a + b for a, b in zip(mine, others, strict=True)))

    @property
    def precision(self) -> float:
        """Share of the estimate's contour that is near the true one; NaN without any."""
        return self.estimated_near_true / self.estimated if self.estimated else float("nan")

    @property
    def recall(self) -> float:
        """Share of the true contour that is near the estimate's; NaN without any."""
        return self.true_near_estimated / self.true if self.true else float("nan")

    @property
    def f_score(self) -> float:
        """Harmonic mean of both; NaN without a true contour, 0 where nothing matches."""
        if not self.true:
            return float("nan")
        if not self.estimated_near_true or not self.true_near_estimated:
            return 0.0
        return 2 / (1 / self.precision + 1 / self.recall)
