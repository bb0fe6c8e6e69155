"""What pictures of planes tell about a camera: its mask, and how blur grows with depth."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Mask, render_psf_stack


@dataclasses.dataclass(frozen=True)
class ThinLens:
    """The line ``S = slope (1 / z_focus - 1 / z)`` of signed blur sizes (thesis eq. 3.28)."""

    # ``M f_px``, pixels times metres, positive. Mask extent and focal length occur in this product
    # only, so planes alone cannot tell the one from the other.
    slope_px_m: float
    # ``1 / z_focus``, 1/m; 0 or less where the blur vanishes nowhere in front of the camera.
    inverse_focus: float

    @property
    def focus_distance_m(self) -> float:
        """Distance of the plane in focus; infinite where there is none."""
        return 1 / self.inverse_focus if self.inverse_focus > 0 else np.inf

    def blur_size_px(self, depth_m: ArrayLike) -> DoubleArray:
        """Return the signed blur size at depths in metres."""
        return self.slope_px_m * (self.inverse_focus - 1 / np.asarray(depth_m, np.float64))

    def inverse_depth(self, blur_size_px: ArrayLike) -> DoubleArray:
        """Return the inverse depth at signed blur sizes; 0 or less at and beyond infinity's."""
        size_px = np.asarray(blur_size_px, np.float64)
        return np.asarray(self.inverse_focus - size_px / self.slope_px_m)

    def depth_m(self, blur_size_px: ArrayLike) -> DoubleArray:
        """Return the depth at signed blur sizes; infinite at and beyond that of infinity."""
        inverse = self.inverse_depth(blur_size_px)
        positive = inverse > 0
        return np.where(positive, 1 / np.where(positive, inverse, 1.0), np.inf)

    def blur_range_px(self, near_m: float, far_m: float) -> tuple[float, float]:
        """Return the signed blur sizes at the ends of a depth range, the smaller one first.

        Raises `InputError` if the range is not one, or has the focus inside.
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
    """A mask as learned from planes, with the line of the thin lens.

    Raises `InputError` if an attribute has another shape or range.
    """

    mask: Mask  # a single mask: the PSFs are its. Blur sizes are the extent of its grid.
    # [R, m, m]; masks whose autocorrelations add up to that of the mask; the filters are theirs.
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
        """Return the PSFs of the parts at blur sizes of the mask [R, L, k, k].

        They are as bright as the parts are.
        """
        sizes = np.abs(np.asarray(blur_sizes_px, np.float64)) * self.parts_extent
        psfs = [
            render_psf_stack(Mask("part", part / part.max()), sizes).psfs * part.sum()
            for part in self.parts
        ]
        return np.array(psfs)
