"""A bank for another focus or another depth range, without new pictures (thesis chapter 10).

The filters belong to blur sizes, and only the image formation model (thesis eq. 3.28) says at
which depth a blur size occurs. So another focus gives the same filters other depths; another
depth range needs filters for other blur sizes of the same mask.
"""

import dataclasses

import numpy as np

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank.for_camera import (
    for_camera,
    learn_bank_for_camera,
    learn_bank_for_pattern,
)
from coded_aperture_ros.likelihood.bank.learning import LearnConfig
from coded_aperture_ros.likelihood.bank.model import FilterBank
from coded_aperture_ros.likelihood.bank.pattern import LearnedPattern
from coded_aperture_ros.optics import Camera, image_distance
from coded_aperture_ros.optics.lens import check_focus_distance


def remap_bank(
    bank: FilterBank,
    camera: Camera,
    near_m: float | None = None,
    far_m: float | None = None,
    level_count: int | None = None,
) -> FilterBank:
    """Make the bank of another setting of the same lens and mask; all else stays as it is.

    The bank was learned from planes, from the camera's own mask, or from measured PSFs with sizes
    in px. The camera has the new setting: focus, side of the scene, and image width (of the same
    view). A bank from planes keeps its own mask and the slope of its blur sizes, which were
    measured; where the camera's focal length in mm is known, the image distance follows the focus.

    With a depth range in m there are new levels, by default as many as before; without it the
    filters stay as they are, and get new depths. Raises `InputError` if the range does not suit the
    camera, the levels lie where the camera has no depth, or new levels are asked of a bank whose
    mask is not known.
    """
    if (near_m is None) != (far_m is None):
        raise InputError("a depth range needs both near_m and far_m")
    if level_count is not None and near_m is None:
        raise InputError("level_count: other levels need a depth range")
    pattern = None if bank.pattern is None else refocused(bank.pattern, camera)
    learned_from = f"{bank.learned_from}; for a focus at {camera.focus_distance_m:g} m"
    if pattern is None and not bank.stack.in_pixels:
        raise InputError("the bank's levels have no blur sizes in px, so they have no depths")
    if pattern is None and bank.mask_digest not in ("", camera.mask.digest):
        raise InputError(f"the bank is for another mask than the camera's {camera.mask.name}")
    if near_m is None or far_m is None:
        return _with_new_depths(bank, pattern, camera, learned_from)
    config = LearnConfig(bank.window_px, bank.basis_vectors, bank.highest_frequency, bank.noise)
    count = bank.levels if level_count is None else level_count
    if pattern is not None:
        camera.blur_range_px(near_m, far_m)  # refuses what is not on the camera's side
        new = learn_bank_for_pattern(
            pattern, near_m, far_m, count, config, bank.prior, learned_from
        )
    elif bank.mask_digest:
        new = learn_bank_for_camera(camera, near_m, far_m, count, config, prior=bank.prior)
    else:
        raise InputError(
            "the bank was learned from PSFs, and the mask that other blur sizes follow from is not "
            "known: leave out the depth range, and its levels get new depths"
        )
    return dataclasses.replace(for_camera(new, camera), stride_px=bank.stride_px)


def refocused(pattern: LearnedPattern, camera: Camera) -> LearnedPattern:
    """Return the pattern of the same lens and mask in a camera's setting (thesis eq. 3.14, 3.28).

    All sizes in px scale with the width of the pictures. Where the focal length in mm is known, the
    image distance follows the focus; else it stays, which is off by about the focal length over
    the distance. Raises `InputError` if the lens cannot be focused there.
    """
    slope = pattern.slope_px_m * camera.image_width / pattern.image_width
    focal_length_mm = camera.focal_length_mm
    if focal_length_mm is not None and np.isfinite(pattern.focus_distance_m):
        distances_m = camera.focus_distance_m, pattern.focus_distance_m
        for distance_m in distances_m:
            check_focus_distance(focal_length_mm, distance_m)
        after, before = (image_distance(focal_length_mm, z * 1e3) for z in distances_m)
        slope *= after / before
    return dataclasses.replace(
        pattern,
        slope_px_m=slope,
        inverse_focus=1 / camera.focus_distance_m,
        image_width=camera.image_width,
    )


def _with_new_depths(
    bank: FilterBank, pattern: LearnedPattern | None, camera: Camera, learned_from: str
) -> FilterBank:
    """Return the same filters with the depths that their blur sizes have now."""
    sizes_px = bank.blur_sizes_px
    side = {"far": 1, "near": -1, "both": 0}[camera.side]
    if np.sign(np.median(sizes_px)) * side < 0:
        raise InputError(
            f"the bank's blur sizes are {sizes_px.min():.1f} to {sizes_px.max():.1f} px, on the "
            f"other side of the focus than the camera's side {camera.side}: give a depth range, "
            "and levels are learned there"
        )
    if pattern and bank.pattern and pattern.image_width != bank.pattern.image_width:
        raise InputError(
            "pictures of another width have other blur sizes: give a depth range, and levels "
            "are learned for them"
        )
    depths_m = (pattern or camera).depth_m(sizes_px)
    if not np.isfinite(depths_m).all():
        infinite = int((~np.isfinite(depths_m)).sum())
        raise InputError(
            f"{infinite} of {bank.levels} levels are blurred more than infinity is with the focus "
            f"at {camera.focus_distance_m:g} m: give a depth range, and levels are learned for it"
        )
    stack = dataclasses.replace(bank.stack, depths_m=depths_m)
    remapped = dataclasses.replace(bank, stack=stack, pattern=pattern, learned_from=learned_from)
    return for_camera(remapped, camera)
