"""Depth levels and blur against focus and depth (thesis 3.4.2), and the best focus."""

import dataclasses
import math

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.design.openings import mask_openings
from coded_aperture_ros.design.setting import (
    DesignConfig,
    Setting,
    design_setting,
    mean_blur_size_px,
    resolution_m,
)
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.pupil import exceeds_pupil, largest_extent_mm

_SAMPLES = 200
# Settings whose number of levels is within this of the most count as equal.
_EQUAL_SHARE = 0.98


@dataclasses.dataclass(frozen=True, eq=False)
class Curves:
    """Graphs of thesis figures 3.10 and 3.12, as numbers."""

    # Focus distances, increasing [n]; those within the depth range, where the side of the focus is
    # ambiguous, are left out.
    focus_m: DoubleArray
    levels: DoubleArray  # depth levels there (eq. 3.29)
    # Blur of the smallest hole there (eq. 3.16): mean over the depth range, and at its far end.
    hole_blur_mean_px: DoubleArray
    hole_blur_far_px: DoubleArray
    depth_m: DoubleArray  # in the range [k]
    resolution_m: DoubleArray  # there (eq. 3.30), at the camera's own focus
    # Depths from `near_m` to `far_m`, one resolvable step of blur size apart [levels + 1].
    level_edges_m: DoubleArray


def design_curves(
    camera: Camera,
    near_m: float,
    far_m: float,
    config: DesignConfig | None = None,
    focus_range_m: tuple[float, float] | None = None,
) -> Curves:
    """Curves of a camera over a depth range on its side of the focus.

    Parameters
    ----------
    camera : Camera
    near_m, far_m : float
        Depth range, m.
    config : DesignConfig, optional
    focus_range_m : (float, float), optional
        Focus distances, m; by default `default_focus_range_m`, with the camera's own.

    Returns
    -------
    Curves

    Raises
    ------
    InputError
        As `design_setting`; also if the focus range lies within the depth range.

    References
    ----------
    Martinello 2012, section 3.4.2.

    Examples
    --------
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(1000.0, 2.0, 640, 480, Mask.named("levin"), mask_extent_mm=20.0)
    >>> curves = design_curves(camera, 2.5, 6.0)
    >>> bool((curves.resolution_m > 0).all())
    True
    """
    config = config or DesignConfig()
    near_px, far_px = camera.blur_range_px(near_m, far_m)
    if focus_range_m is None:
        low_m, high_m = default_focus_range_m(camera, near_m, far_m)
        focus_m = camera.focus_distance_m
        focus_range_m = min(low_m, focus_m), max(high_m, focus_m)
    share = mask_openings(camera.mask).smallest_width
    cameras = refocused_cameras(camera, near_m, far_m, focus_range_m)
    levels = [one.number_of_levels(near_m, far_m, config.resolution_px) for one in cameras]
    mean_px = [mean_blur_size_px(one, near_m, far_m) for one in cameras]
    steps_px = np.arange(near_px, far_px, config.resolution_px)
    depth_m = np.linspace(near_m, far_m, _SAMPLES)
    return Curves(
        focus_m=np.array([one.focus_distance_m for one in cameras]),
        levels=np.array(levels),
        hole_blur_mean_px=share * np.abs(mean_px),
        hole_blur_far_px=share * np.abs([one.blur_size_px(far_m) for one in cameras]),
        depth_m=depth_m,
        resolution_m=resolution_m(camera, depth_m, config.resolution_px),
        level_edges_m=np.append(camera.depth_m(steps_px), far_m),
    )


def default_focus_range_m(camera: Camera, near_m: float, far_m: float) -> tuple[float, float]:
    """Focus distances to search, m: a quarter of `near_m` to four times `far_m`.

    No nearer than twice the focal length, where the image has the size of the object, or twice the
    mask's distance.

    Examples
    --------
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(1000.0, 2.0, 64, 48, Mask.named("levin"), mask_extent_mm=10.0)
    >>> default_focus_range_m(camera, 2.0, 5.0)
    (0.5, 20.0)
    """
    closest_m = 2e-3 * max(camera.focal_length_mm or 0.0, camera.lens_mask_distance_mm)
    return max(near_m / 4, min(closest_m, near_m)), 4 * far_m


def default_extent_range_mm(camera: Camera) -> tuple[float, float]:
    """Mask extents to search, mm: half the camera's to twice the camera's, within the pupil.

    Examples
    --------
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(1000.0, 2.0, 64, 48, Mask.named("levin"), mask_extent_mm=10.0)
    >>> default_extent_range_mm(camera)
    (5.0, 20.0)
    """
    largest_mm = largest_extent_mm(camera.mask, camera.pupil_mm)
    return camera.mask_extent_mm / 2, min(camera.mask_extent_mm * 2, largest_mm)


def extents_within_pupil(
    camera: Camera, extent_range_mm: tuple[float, float]
) -> tuple[float, float]:
    """Part of a range of mask extents, mm, that fits into the pupil of the lens.

    Raises `InputError` if the range is not increasing, or no mask of it fits.

    Examples
    --------
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.optics import Mask
    >>> lens = {"focal_length_mm": 25.0, "lens_f_number": 1.4}
    >>> camera = Camera(1000.0, 2.0, 64, 48, Mask.named("four_hole"), 10.0, **lens)
    >>> extents_within_pupil(camera, (5.0, 20.0))
    (5.0, 12.6)
    """
    low_mm, high_mm = extent_range_mm
    if not 0 < low_mm <= high_mm < math.inf:
        raise InputError(
            f"mask sizes {low_mm:g} to {high_mm:g} mm: expected two increasing sizes of more than "
            "0 mm"
        )
    if reason := exceeds_pupil(camera.mask, low_mm, camera.pupil_mm):
        raise InputError(f"mask sizes: {reason}")
    largest_mm = largest_extent_mm(camera.mask, camera.pupil_mm)
    return min(low_mm, largest_mm), min(high_mm, largest_mm)


def refocused_cameras(
    camera: Camera, near_m: float, far_m: float, focus_range_m: tuple[float, float]
) -> list[Camera]:
    """Camera focused at many distances outside the depth range, nearest first.

    On each side of the range, they are equally spaced in the logarithm of the distance. Raises
    `InputError` if the focus range is not increasing, or lies within the depth range.
    """
    low_m, high_m = focus_range_m
    if not 0 < low_m < high_m < math.inf:
        raise InputError(
            f"focus range {low_m:g} to {high_m:g} m: expected two increasing distances beyond 0 m"
        )
    sides = (("far", low_m, min(high_m, near_m)), ("near", max(low_m, far_m), high_m))
    with naming(f"focus range {low_m:g} to {high_m:g} m"):
        cameras = [
            dataclasses.replace(camera.refocused(float(focus_m)), side=side)
            for side, first_m, last_m in sides
            if first_m < last_m
            for focus_m in np.geomspace(first_m, last_m, _SAMPLES)
        ]
    if not cameras:
        raise InputError(
            f"focus range {low_m:g} to {high_m:g} m: it lies within the depth range {near_m:g} to "
            f"{far_m:g} m, where points on the two sides of the focal plane give the same blur: "
            f"use one that begins before {near_m:g} m or ends beyond {far_m:g} m"
        )
    return cameras


def best_settings(
    camera: Camera,
    near_m: float,
    far_m: float,
    config: DesignConfig | None = None,
    focus_range_m: tuple[float, float] | None = None,
    extent_range_mm: tuple[float, float] | None = None,
) -> list[Setting]:
    """Focus distance and mask extent with the most depth levels, before and beyond the depth range.

    The focus lies outside the depth range, and the blur sizes within the limits of `config`. The
    number of levels hardly depends on the focus, so among settings that are as good within 2 % the
    one wins whose smallest hole blurs closest to 1 px, which keeps most of the image.

    Parameters
    ----------
    camera : Camera
        Its focus, side and mask extent matter only for the default ranges.
    near_m, far_m : float
        Depth range, m.
    config : DesignConfig, optional
    focus_range_m, extent_range_mm : (float, float), optional
        Ranges of the search; by default `default_focus_range_m` and `default_extent_range_mm`. No
        mask is wider than what the pupil takes.

    Returns
    -------
    list of Setting
        The best setting with the focus before the depth range and the best one beyond it, the one
        with more levels first. A side is missing where no setting in the ranges keeps the blur
        within its limits.

    Raises
    ------
    InputError
        If a range is not increasing, or the focus range lies within the depth range.

    Examples
    --------
    >>> from coded_aperture_ros import Camera
    >>> from coded_aperture_ros.optics import Mask
    >>> camera = Camera(1000.0, 2.0, 640, 480, Mask.named("levin"), mask_extent_mm=20.0)
    >>> [setting.side for setting in best_settings(camera, 2.5, 6.0)]
    ['far', 'near']
    """
    config = config or DesignConfig()
    focus_range_m = focus_range_m or default_focus_range_m(camera, near_m, far_m)
    extent_range_mm = extent_range_mm or default_extent_range_mm(camera)
    extent_range_mm = extents_within_pupil(camera, extent_range_mm)
    found: dict[str, list[Setting]] = {"far": [], "near": []}
    for focused in refocused_cameras(camera, near_m, far_m, focus_range_m):
        # The largest allowed mask is the best at a focus: levels and blur both grow with its size.
        sizes_px = [abs(size) for size in focused.blur_range_px(near_m, far_m)]
        per_mm = [size / focused.mask_extent_mm for size in sizes_px]
        extent_mm = min(extent_range_mm[1], config.largest_blur_px / max(per_mm))
        if extent_mm >= extent_range_mm[0] and extent_mm * min(per_mm) >= config.smallest_blur_px:
            candidate = dataclasses.replace(focused, mask_extent_mm=extent_mm)
            found[focused.side].append(design_setting(candidate, near_m, far_m, config))
    best = []
    for settings in filter(None, found.values()):
        most = max(setting.levels for setting in settings)
        as_good = [setting for setting in settings if setting.levels >= _EQUAL_SHARE * most]
        best.append(min(as_good, key=lambda setting: abs(math.log(setting.hole_blur_mean_px))))
    return sorted(best, key=lambda setting: -setting.levels)
