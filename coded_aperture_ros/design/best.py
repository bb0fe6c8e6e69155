"""The focus distance and the mask size that tell most depths apart, on each side of the range."""

import dataclasses
import math

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.curves import (
    default_extent_range_mm,
    default_focus_range_m,
    refocused_cameras,
)
from coded_aperture_ros.design.setting import DesignConfig, Setting, setting_of
from coded_aperture_ros.optics import Camera

# Settings whose number of levels is within this of the most count as equal.
_AS_GOOD = 0.98


def best_settings(
    camera: Camera,
    near_m: float,
    far_m: float,
    config: DesignConfig | None = None,
    focus_range_m: tuple[float, float] | None = None,
    extent_range_mm: tuple[float, float] | None = None,
) -> list[Setting]:
    """Search focus distance and mask size for the most depth levels.

    The focus lies outside the depth range, and the blur sizes within the limits of `config`.
    The number of levels hardly depends on the focus, so among settings that are as good within
    2 % the one wins whose smallest hole blurs closest to 1 px, which keeps most of the image.

    Parameters
    ----------
    camera : Camera
        Its focus, side and mask size matter only for the default ranges.
    near_m, far_m : float
        Depth range.
    config : DesignConfig, optional
    focus_range_m, extent_range_mm : tuple of two floats, optional
        What is searched; by default `default_focus_range_m` and `default_extent_range_mm`.

    Returns
    -------
    list of Setting
        The best setting with the focus before the depth range and the best one beyond it, the
        one with more levels first. A side is missing where no setting in the ranges keeps the
        blur within its limits.

    Raises
    ------
    InputError
        If a range is not one, or the focus range lies within the depth range.
    """
    config = config or DesignConfig()
    focus_range_m = focus_range_m or default_focus_range_m(camera, near_m, far_m)
    extent_range_mm = extent_range_mm or default_extent_range_mm(camera)
    if not 0 < extent_range_mm[0] <= extent_range_mm[1] < math.inf:
        raise InputError(
            f"mask sizes {extent_range_mm[0]:g} to {extent_range_mm[1]:g} mm: expected two "
            "increasing sizes of more than 0 mm"
        )
    found: dict[str, list[Setting]] = {"far": [], "near": []}
    for focused in refocused_cameras(camera, near_m, far_m, focus_range_m):
        # The largest allowed mask is the best at a focus: levels and blur both grow with its size.
        sizes_px = [abs(size) for size in focused.blur_range_px(near_m, far_m)]
        per_mm = [size / focused.mask_extent_mm for size in sizes_px]
        extent_mm = min(extent_range_mm[1], config.largest_blur_px / max(per_mm))
        if extent_mm >= extent_range_mm[0] and extent_mm * min(per_mm) >= config.smallest_blur_px:
            candidate = dataclasses.replace(focused, mask_extent_mm=extent_mm)
            found[focused.side].append(setting_of(candidate, near_m, far_m, config))
    best = [_sharpest_of_the_best(settings) for settings in found.values() if settings]
    return sorted(best, key=lambda setting: -setting.levels)


def _sharpest_of_the_best(settings: list[Setting]) -> Setting:
    most = max(setting.levels for setting in settings)
    as_good = [setting for setting in settings if setting.levels >= _AS_GOOD * most]
    return min(as_good, key=lambda setting: abs(math.log(setting.hole_blur_mean_px)))
