"""Filter banks and PSF stacks of a camera, or of a mask known from planes, for a depth range."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood.bank.empirical import EmpiricalPrior
from coded_aperture_ros.likelihood.bank.field import FieldPsfs, psfs_at
from coded_aperture_ros.likelihood.bank.learning import LearnConfig, learn_bank
from coded_aperture_ros.likelihood.bank.model import FilterBank, check_level_count
from coded_aperture_ros.likelihood.bank.pattern import LearnedPattern
from coded_aperture_ros.likelihood.bank.prior import NaturalImagePrior
from coded_aperture_ros.optics import Camera, PsfStack, render_psf_stack
from coded_aperture_ros.optics.pupil import wider_mask_advice

# Blur levels that a depth range is divided into, unless something else is asked for.
DEFAULT_LEVEL_COUNT = 30
# Smallest difference of blur between the ends of a depth range, px.
_MIN_SPAN_PX = 1.0


def learn_bank_for_camera(
    camera: Camera,
    near_m: float,
    far_m: float,
    level_count: int = DEFAULT_LEVEL_COUNT,
    config: LearnConfig | None = None,
    progress: Progress = iter,
    prior: NaturalImagePrior | None = None,
) -> FilterBank:
    """Filter bank of a camera for a depth range, from its mask alone.

    Parameters
    ----------
    camera : Camera
    near_m, far_m : float
        Depth range, m.
    level_count : int, optional
        Number of levels, equally spaced in blur size; at least 2. On both sides of the focus they
        mirror each other, so that one end may lie a little beyond the range.
    config, progress, prior
        See `learn_bank`.

    Raises
    ------
    InputError
        If the range does not lie on the camera's side of the focal plane or ends at infinity,
        there are fewer than two levels, or a blur size does not fit the window.

    References
    ----------
    Martinello 2012, eq. 3.28 and chapter 6.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Camera, Mask
    >>> camera = Camera(640.0, 1.0, 160, 120, Mask.named("levin"), 46.0)
    >>> bank = learn_bank_for_camera(camera, 1.2, 2.4, 5)
    >>> bank.blur_sizes_px.round(1).tolist()
    [4.9, 8.0, 11.0, 14.1, 17.2]
    """
    stack = psf_stack_for_camera(camera, near_m, far_m, level_count)
    learned_from = f"mask {camera.mask.name}, {near_m:g} to {far_m:g} m, {describe_textures(prior)}"
    field = FieldPsfs.from_camera(camera, stack.blur_sizes_px)
    bank = learn_bank(stack, config, prior, learned_from, camera.mask, progress, field=field)
    return with_camera(bank, camera)


def with_camera(bank: FilterBank, camera: Camera) -> FilterBank:
    """Bank with the setting of a camera and the size of its frames, which it then checks."""
    return dataclasses.replace(
        bank,
        image_width=camera.image_width,
        image_height=camera.image_height,
        setting_digest=camera.setting_digest,
    )


def psf_stack_for_camera(
    camera: Camera, near_m: float, far_m: float, level_count: int, purpose: str = "a bank"
) -> PsfStack:
    """PSFs of a camera for a depth range, equally spaced in blur size.

    With field curvature the range is that of the blur sizes of the whole field.

    Parameters
    ----------
    camera, near_m, far_m, level_count
        See `learn_bank_for_camera`.
    purpose : str
        What the PSFs are for, in messages.

    Raises
    ------
    InputError
        See `learn_bank_for_camera`.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Camera, Mask
    >>> camera = Camera(640.0, 1.0, 160, 120, Mask.named("levin"), 46.0)
    >>> psf_stack_for_camera(camera, 1.2, 2.4, 5).depths_m.round(2).tolist()
    [1.2, 1.37, 1.6, 1.92, 2.4]
    """
    check_level_count(level_count)
    check_depth_range(camera, near_m, far_m)
    blur_sizes = _blur_sizes(camera, near_m, far_m, level_count)
    depths_m = camera.depth_m(blur_sizes)
    if not np.isfinite(depths_m).all():
        raise InputError(
            f"depth range {near_m:g} to {far_m:g} m: {purpose} needs finite depths; far away they "
            "differ little in blur, 100 times the distance of the focus is enough"
        )
    if camera.wavefront is not None:
        return PsfStack(blur_sizes, psfs_at(camera, blur_sizes, np.zeros(2)), depths_m)
    stack = render_psf_stack(camera.mask, blur_sizes, camera.psf_diffraction_px)
    return dataclasses.replace(stack, depths_m=depths_m)


def check_depth_range(camera: Camera, near_m: float, far_m: float) -> None:
    """Check that a depth range lies on the camera's side, and that its ends differ in blur.

    Raises
    ------
    InputError
        Saying what to change.
    """
    span_px = float(np.ptp(camera.blur_range_px(near_m, far_m)))
    if span_px >= _MIN_SPAN_PX:
        return
    wider = wider_mask_advice(camera.mask, camera.mask_extent_mm, camera.pupil_mm)
    raise InputError(
        f"depth range {near_m:g} to {far_m:g} m: its ends differ by {span_px:.2g} px of blur with "
        f"the focus at {camera.focus_distance_m:g} m, so no two depths can be told apart: check "
        f"the units (distances in m, mask_extent_mm in mm), or use {wider}, a "
        "nearer focus, or a longer lens"
    )


def _blur_sizes(camera: Camera, near_m: float, far_m: float, count: int) -> DoubleArray:
    """Equally spaced blur sizes [count], px, the same on both sides of the focus.

    Else the side with a level nearer to a size would seem the likelier one. One end may lie a
    little beyond the range for that.
    """
    smallest_px, largest_px = camera.field_blur_range_px(near_m, far_m)
    if not smallest_px < 0 < largest_px:
        return np.linspace(smallest_px, largest_px, count)
    if count < 3:
        raise InputError(f"levels on both sides of the focus: at least 3 are needed, got {count}")
    beyond = np.arange(1, count - 1)
    steps = np.maximum(largest_px / beyond, -smallest_px / (count - 1 - beyond))
    steps[steps * beyond >= max(camera.blur_at_infinity_px, largest_px * (1 + 1e-9))] = np.inf
    best = int(steps.argmin())
    return np.arange(beyond[best] - count + 1, beyond[best] + 1) * steps[best]


def learn_bank_for_pattern(
    pattern: LearnedPattern,
    near_m: float,
    far_m: float,
    level_count: int = DEFAULT_LEVEL_COUNT,
    config: LearnConfig | None = None,
    prior: NaturalImagePrior | None = None,
    learned_from: str = "planes",
) -> FilterBank:
    """Filter bank of a mask that is known from planes, for a depth range.

    Its depths do not depend on a camera file.

    Parameters
    ----------
    pattern : LearnedPattern
    near_m, far_m : float
        Depth range, m, on one side of the focus.
    level_count, config, prior, learned_from
        See `learn_bank_for_camera` and `learn_bank`.

    Raises
    ------
    InputError
        See `learn_bank_for_camera` and `learn_bank`, or if the focus lies within the range.

    References
    ----------
    Martinello 2012, eq. 3.28.

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.optics import Mask
    >>> mask = Mask.named("levin")
    >>> pattern = LearnedPattern(
    ...     slope_px_m=29.0, inverse_focus=1.0, mask=mask, parts=mask.transmission[None],
    ...     parts_extent=1.0, image_width=640,
    ... )
    >>> learn_bank_for_pattern(pattern, 1.2, 2.4, 3).stack.depths_m.round(2).tolist()
    [1.2, 1.6, 2.4]
    """
    check_level_count(level_count)
    sizes_px = np.linspace(*pattern.blur_range_px(near_m, far_m), level_count)
    stack = render_psf_stack(pattern.mask, sizes_px)
    stack = dataclasses.replace(stack, depths_m=pattern.depth_m(sizes_px))
    components = pattern.components(sizes_px)
    bank = learn_bank(stack, config, prior, learned_from, components=components)
    return dataclasses.replace(bank, pattern=pattern)


def describe_textures(prior: NaturalImagePrior | None) -> str:
    """Origin of a prior's textures, for a person to read.

    Examples
    --------
    >>> describe_textures(None)
    'natural-image prior'
    """
    if isinstance(prior, EmpiricalPrior):
        return f"{len(prior.slopes)} kinds of texture from sharp images"
    return "natural-image prior"


def guarded_range(
    camera: Camera, near_m: float, far_m: float, level_count: int
) -> tuple[float, float, int]:
    """Depth range (m, m) with one more level on either side, and its number of levels.

    What is too near or beyond the range is most similar to one of these levels. Without them it
    would be taken, with full confidence, for something at the end of the range.

    Raises
    ------
    InputError
        If the range does not suit the camera.
    """
    ends = np.array(camera.blur_range_px(near_m, far_m))
    step = (ends[1] - ends[0]) / (level_count - 1)
    beyond = np.array([ends[0] - step, ends[1] + step])
    # At most half of the way to the plane in focus or to infinity.
    focus_end = np.argmin(np.abs(ends))
    nearer_focus = abs(beyond[focus_end]) < abs(ends[focus_end]) / 2
    if ends[0] * ends[1] > 0 and (nearer_focus or beyond[focus_end] * ends[0] < 0):
        beyond[focus_end] = ends[focus_end] / 2
    beyond[1] = min(beyond[1], (ends[1] + camera.blur_at_infinity_px) / 2)
    nearest_m, farthest_m = camera.depth_m(beyond)
    return float(nearest_m), float(farthest_m), level_count + 2
