"""Mask and thin lens of a camera as found from pictures of planes."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Mask, render_psf_stack


@dataclasses.dataclass(frozen=True)
class ThinLens:
    """Signed blur sizes ``S = slope (1 / z_focus - 1 / z)`` of a thin lens.

    References
    ----------
    Martinello 2012, eq. 3.28.

    Examples
    --------
    >>> lens = ThinLens(slope_px_m=20.0, inverse_focus=1.0)
    >>> float(lens.blur_size_px(2.0)), float(lens.depth_m(10.0))
    (10.0, 2.0)
    """

    # ``M f_px``, px m, positive. Mask extent and focal length occur in this product only, so planes
    # alone do not determine each of them.
    slope_px_m: float
    # ``1 / z_focus``, 1/m; 0 or less where the blur vanishes nowhere in front of the camera.
    inverse_focus: float

    @property
    def focus_distance_m(self) -> float:
        """Distance of the plane in focus, m; infinite if there is none."""
        return 1 / self.inverse_focus if self.inverse_focus > 0 else np.inf

    def blur_size_px(self, depth_m: ArrayLike) -> DoubleArray:
        """Signed blur size, px, at depths in m."""
        return self.slope_px_m * (self.inverse_focus - 1 / np.asarray(depth_m, np.float64))

    def inverse_depth(self, blur_size_px: ArrayLike) -> DoubleArray:
        """Inverse depth, 1/m, at signed blur sizes; 0 or less at and beyond that of infinity."""
        size_px = np.asarray(blur_size_px, np.float64)
        return np.asarray(self.inverse_focus - size_px / self.slope_px_m)

    def depth_m(self, blur_size_px: ArrayLike) -> DoubleArray:
        """Depth, m, at signed blur sizes; infinite at and beyond that of infinity."""
        inverse = self.inverse_depth(blur_size_px)
        positive = inverse > 0
        return np.where(positive, 1 / np.where(positive, inverse, 1.0), np.inf)

    def blur_range_px(self, near_m: float, far_m: float) -> tuple[float, float]:
        """Signed blur sizes, px, at the ends of a depth range, the smaller one first.

        Raises
        ------
        InputError
            If the range is empty or infinite, or the focus lies inside.
        """
        if not 0 < near_m < far_m < np.inf:
            raise InputError(
                f"depth range {near_m:g} to {far_m:g} m: expected two increasing distances"
            )
        smallest, largest = self.blur_size_px([near_m, far_m])
        if smallest < 0 < largest:
            raise InputError(
                f"the focus at {self.focus_distance_m:.3g} m lies inside the depth range "
                f"{near_m:g} to {far_m:g} m: points on its two sides have the same blur; focus "
                "before or beyond the range, or narrow the range to one side"
            )
        return float(smallest), float(largest)


@dataclasses.dataclass(frozen=True, eq=False)
class LearnedPattern(ThinLens):
    """Mask and thin lens as found from pictures of planes.

    Raises
    ------
    InputError
        If an attribute has another shape or range.

    Examples
    --------
    >>> mask = Mask.named("levin")
    >>> pattern = LearnedPattern(29.0, 1.0, mask, mask.transmission[None], 1.0, 640)
    >>> pattern.components([5.0, 7.0]).shape
    (1, 2, 9, 9)
    """

    mask: Mask  # of the PSFs; blur sizes are the extent of its grid
    # [R, m, m]; masks of the filters, whose autocorrelations add up to that of the mask.
    parts: DoubleArray
    parts_extent: float  # width of the parts' grid over that of the mask's
    image_width: int  # width of the pictures, px

    def __post_init__(self) -> None:
        parts = np.asarray(self.parts, np.float64)
        if parts.ndim != 3 or parts.shape[1] != parts.shape[2] or not parts.size:
            raise InputError(f"parts: expected the shape [R, m, m], got {list(parts.shape)}")
        if not (np.isfinite(parts).all() and (parts >= 0).all() and parts.any(axis=(1, 2)).all()):
            raise InputError("parts: expected finite numbers from 0, not all of them 0")
        for name in ("parts_extent", "slope_px_m", "image_width"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"{name}: expected more than 0, got {getattr(self, name)!r}")
        if not np.isfinite(self.inverse_focus):
            raise InputError(f"inverse_focus: expected a number, got {self.inverse_focus!r}")
        object.__setattr__(self, "parts", parts)

    def components(self, blur_sizes_px: ArrayLike) -> FloatArray:
        """PSFs of the parts at blur sizes of the mask [R, L, k, k]; their sums are the parts'."""
        sizes = np.abs(np.asarray(blur_sizes_px, np.float64)) * self.parts_extent
        psfs = [
            render_psf_stack(Mask("part", part / part.max()), sizes).psfs * part.sum()
            for part in self.parts
        ]
        return np.array(psfs)
