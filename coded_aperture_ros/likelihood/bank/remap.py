"""Bank for another focus or another depth range, without new pictures (thesis chapter 10).

The filters belong to blur sizes, and depth follows from blur size by the image formation model
(thesis eq. 3.28). So another focus gives the same filters other depths; another
depth range needs filters for other blur sizes of the same mask.
"""

import dataclasses

import numpy as np

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank.for_camera import (
    learn_bank_for_camera,
    learn_bank_for_pattern,
    with_camera,
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
    """Bank of another setting of the same lens and mask.

    A bank from planes keeps its mask and the slope of its blur sizes, which were measured; if the
    camera's focal length in mm is known, the image distance follows the focus.

    Parameters
    ----------
    bank : FilterBank
        Learned from planes, from the camera's mask, or from measured PSFs with sizes in px.
    camera : Camera
        New focus, side of the scene, and image width (of the same view).
    near_m, far_m : float, optional
        Depth range of new levels, m; without it the filters stay, and get new depths.
    level_count : int, optional
        Number of new levels; by default as many as before.

    Raises
    ------
    InputError
        If the range does not suit the camera, the levels lie where the camera has no depth, or the
        mask that new levels need is unknown.

    References
    ----------
    Martinello 2012, chapter 10.

    Examples
    --------
    >>> import dataclasses
    >>> from coded_aperture_ros.optics import Camera, Mask
    >>> camera = Camera(640.0, 1.0, 160, 120, Mask.named("levin"), 46.0)
    >>> bank = learn_bank_for_camera(camera, 1.2, 2.4, 3)
    >>> nearer = dataclasses.replace(camera, focus_distance_m=0.9)
    >>> remap_bank(bank, nearer).stack.depths_m.round(2).tolist()
    [1.06, 1.36, 1.89]
    """
    if (near_m is None) != (far_m is None):
        raise InputError("a depth range needs both near_m and far_m")
    if level_count is not None and near_m is None:
        raise InputError("level_count: other levels need a depth range")
    pattern = None if bank.pattern is None else refocused(bank.pattern, camera)
    learned_from = f"{bank.learned_from}; for a focus at {camera.focus_distance_m:g} m"
    if pattern is None and (bank.stack.nominal or not bank.stack.in_pixels):
        raise InputError("the bank's levels have no blur sizes in px, so they have no depths")
    if pattern is None and bank.mask_digest not in ("", camera.mask.digest):
        raise InputError(f"the bank is for another mask than the camera's {camera.mask.name}")
    if near_m is None or far_m is None:
        return _with_new_depths(bank, pattern, camera, learned_from)
    config = LearnConfig(bank.window_px, bank.basis_vectors, bank.highest_frequency, bank.noise)
    count = bank.levels if level_count is None else level_count
    if pattern is not None:
        camera.blur_range_px(near_m, far_m)  # raises if it is not on the camera's side
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
    return dataclasses.replace(with_camera(new, camera), stride_px=bank.stride_px)


def refocused(pattern: LearnedPattern, camera: Camera) -> LearnedPattern:
    """Pattern of the same lens and mask in a camera's setting (thesis eq. 3.14, 3.28).

    All sizes in px scale with the width of the pictures. If the focal length in mm is known, the
    image distance follows the focus; else it stays, with a relative error of about the focal length
    over the distance.

    Raises
    ------
    InputError
        If the lens cannot be focused there.
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
    """Same filters with the depths of their blur sizes in a camera's setting."""
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
    return with_camera(remapped, camera)
