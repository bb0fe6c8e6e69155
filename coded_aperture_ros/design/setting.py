"""Figures of one setting of a camera: depth resolution, blur, light, diffraction."""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.design.diffraction import airy_width_px
from coded_aperture_ros.design.openings import mask_openings
from coded_aperture_ros.optics import Camera

# Wider Airy discs, px, are not negligible (eq. 3.20): their radius is more than a pixel.
_NEGLIGIBLE_AIRY_PX = 2.0


@dataclasses.dataclass(frozen=True)
class DesignConfig:
    """Resolution of sensor and estimator, and the wanted range of blur sizes.

    Raises
    ------
    InputError
        Naming the setting, its value and what is allowed.

    Examples
    --------
    >>> from coded_aperture_ros.design import DesignConfig
    >>> DesignConfig(largest_blur_px=16.0).smallest_blur_px
    3.0
    """

    resolution_px: float = option(
        1.0,
        "Smallest change of blur size that is told apart, alpha times lambda of thesis eq. 3.29.",
        unit="px",
        within=(0.01, 100.0),
    )
    wavelength_nm: float = option(
        0.0,
        "Wavelength of the light; 0: the camera file's. The thesis takes 750, the longest.",
        unit="nm",
        within=(0.0, 2000.0),
    )
    # Below this the cells of Levin's mask are a quarter of a pixel wide, and the code is lost.
    smallest_blur_px: float = option(
        3.0,
        "The best setting has no smaller blur in the depth range.",
        unit="px",
        within=(0.0, 10_000.0),
    )
    # Half the window of a filter bank with default settings.
    largest_blur_px: float = option(
        24.0,
        "The best setting has no larger blur in the depth range.",
        unit="px",
        within=(0.1, 10_000.0),
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.smallest_blur_px >= self.largest_blur_px:
            raise InputError(
                f"smallest_blur_px: {self.smallest_blur_px:g} px is not less than "
                f"largest_blur_px, {self.largest_blur_px:g} px"
            )


@dataclasses.dataclass(frozen=True)
class Setting:
    """Figures of a camera with one focus and one mask extent over a depth range."""

    focus_distance_m: float
    mask_extent_mm: float
    side: str  # of the focal plane that the depth range is on: far or near
    levels: float  # depths that can be told apart (thesis eq. 3.29)
    # Signed blur size of the whole mask at the two ends of the range (eq. 3.28).
    blur_size_near_px: float
    blur_size_far_px: float
    # Width of the blur of the smallest hole alone (eq. 3.16).
    hole_blur_near_px: float
    hole_blur_far_px: float
    hole_blur_mean_px: float  # over depths spread uniformly over the range
    # Distance to the next depth that can be told apart (eq. 3.30); infinite where none can.
    resolution_near_m: float
    resolution_far_m: float
    hole_width_mm: float  # diameter of the largest disc in the smallest hole
    open_fraction: float  # open area over the area of the square that bounds the mask
    # Focal length over the mask's extent, and over the diameter of the round aperture that passes
    # as much light; None if the focal length is not known.
    f_number: float | None
    f_number_of_light: float | None
    airy_width_px: float  # of the smallest hole's Airy disc, between its first zeros
    diffraction_limit_mm: float  # hole width at which that is 2 px: twice the bound of eq. 3.21

    @property
    def diffraction_is_negligible(self) -> bool:
        """Whether the smallest hole's Airy disc is at most two pixels wide (eq. 3.20)."""
        return self.airy_width_px <= _NEGLIGIBLE_AIRY_PX


def design_setting(
    camera: Camera, near_m: float, far_m: float, config: DesignConfig | None = None
) -> Setting:
    """Figures of a camera over a depth range.

    Parameters
    ----------
    camera : Camera
    near_m, far_m : float
        Depth range, on the camera's side of its focus, m.
    config : DesignConfig, optional

    Returns
    -------
    Setting

    Raises
    ------
    InputError
        If the range is not increasing, is not finite, or does not lie on the camera's side.

    References
    ----------
    Martinello 2012, section 3.4.

    Examples
    --------
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(1000.0, 2.0, 640, 480, Mask.named("levin"), mask_extent_mm=20.0)
    >>> round(design_setting(camera, 2.5, 6.0).levels, 2)
    5.67
    """
    config = config or DesignConfig()
    near_px, far_px = camera.blur_range_px(near_m, far_m)
    if math.isinf(far_m):
        raise InputError(
            f"depth range {near_m:g} to {far_m:g} m: it has to end somewhere, say at 1000 m"
        )
    share = mask_openings(camera.mask).smallest_width
    open_fraction = camera.mask.open_fraction
    hole_mm = share * camera.mask_extent_mm
    resolutions_m = resolution_m(camera, [near_m, far_m], config.resolution_px)
    f_number = camera.f_number
    airy_px = airy_width_px(camera, share, config.wavelength_nm)
    return Setting(
        focus_distance_m=camera.focus_distance_m,
        mask_extent_mm=camera.mask_extent_mm,
        side=camera.side,
        levels=camera.number_of_levels(near_m, far_m, config.resolution_px),
        blur_size_near_px=near_px,
        blur_size_far_px=far_px,
        hole_blur_near_px=share * abs(near_px),
        hole_blur_far_px=share * abs(far_px),
        hole_blur_mean_px=share * abs(mean_blur_size_px(camera, near_m, far_m)),
        resolution_near_m=float(resolutions_m[0]),
        resolution_far_m=float(resolutions_m[1]),
        hole_width_mm=hole_mm,
        open_fraction=open_fraction,
        f_number=f_number,
        # The round aperture of the same area has the diameter M sqrt(4 l / pi).
        f_number_of_light=f_number and f_number / math.sqrt(4 * open_fraction / math.pi),
        airy_width_px=airy_px,
        diffraction_limit_mm=airy_px / _NEGLIGIBLE_AIRY_PX * hole_mm,
    )


def resolution_m(camera: Camera, depth_m: ArrayLike, resolution_px: float = 1.0) -> DoubleArray:
    """Distance from each depth to the next one that can be told apart, m (eq. 3.30).

    Infinite where even an infinite depth looks the same. `resolution_px` is the smallest change of
    blur size that is told apart.
    """
    return camera.depth_m(camera.blur_size_px(depth_m) + resolution_px) - np.asarray(depth_m)


def resolutions_m(camera: Camera, near_m: float, far_m: float) -> dict[str, tuple[float, float]]:
    """Depth and `resolution_m` at the near end, in the middle and at the far end of a range.

    The middle is that of the inverse depths, as levels are spaced.
    """
    depths_m = {"near": near_m, "middle": 2 / (1 / near_m + 1 / far_m), "far": far_m}
    steps_m = resolution_m(camera, list(depths_m.values())).tolist()
    return {name: (depths_m[name], step) for name, step in zip(depths_m, steps_m, strict=True)}


def mean_blur_size_px(camera: Camera, near_m: float, far_m: float) -> float:
    """Mean signed blur size over depths spread uniformly from `near_m` to `far_m`, px.

    The blur size is `S_inf (1 - (z_focus - C) / (z - C))`, which is integrated in closed form.
    """
    mask_m = camera.lens_mask_distance_mm * 1e-3
    mean_inverse = math.log((far_m - mask_m) / (near_m - mask_m)) / (far_m - near_m)
    relative = 1.0 - (camera.focus_distance_m - mask_m) * mean_inverse
    return camera.blur_at_infinity_px * relative
