"""Filter banks and PSF stacks of a camera, or of a mask known from planes, for a depth range."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood.bank.empirical import EmpiricalPrior
from coded_aperture_ros.likelihood.bank.field import FieldPsfs, psfs_at
from coded_aperture_ros.likelihood.bank.learning import LearnConfig, learn_bank
from coded_aperture_ros.likelihood.bank.model import FilterBank, check_levels
from coded_aperture_ros.likelihood.bank.pattern import LearnedPattern
from coded_aperture_ros.likelihood.bank.prior import NaturalImagePrior
from coded_aperture_ros.optics import Camera, PsfStack, render_psf_stack

# Blur levels that a depth range is divided into, unless something else is asked for.
DEFAULT_LEVEL_COUNT = 30
# Smallest difference of blur between the ends of a depth range, px.
_MIN_SPAN_PX = 1.0


def learn_bank_for_camera(
    camera: Camera,
    near_m: float,
    far_m: float,
    level_count: int,
    config: LearnConfig | None = None,
    progress: Progress = iter,
    prior: NaturalImagePrior | None = None,
) -> FilterBank:
    """Learn the bank of a camera for a depth range, from its mask alone.

    Parameters
    ----------
    near_m, far_m : float
        Depth range, metres.
    level_count : int
        Number of levels, equally spaced in blur size; at least 2. On both sides of the focus they
        mirror each other, so that one end may lie a little beyond the range.
    config, progress, prior
        See `learn_bank`.

    Raises
    ------
    InputError
        If the range does not lie on the camera's side of the focal plane or ends at infinity,
        there are fewer than two levels, or a blur size does not fit the window.
    """
    stack = psf_stack_for_camera(camera, near_m, far_m, level_count)
    learned_from = f"mask {camera.mask.name}, {near_m:g} to {far_m:g} m, {textures_of(prior)}"
    field = FieldPsfs.of(camera, stack.blur_sizes_px)
    bank = learn_bank(stack, config, prior, learned_from, camera.mask, progress, field=field)
    return for_camera(bank, camera)


def for_camera(bank: FilterBank, camera: Camera) -> FilterBank:
    """Return a bank that knows which camera it is for, and which size its frames have."""
    return dataclasses.replace(
        bank,
        image_width=camera.image_width,
        image_height=camera.image_height,
        setting_digest=camera.setting_digest,
    )


def psf_stack_for_camera(
    camera: Camera, near_m: float, far_m: float, level_count: int, whose: str = "a bank"
) -> PsfStack:
    """Render the PSFs of a camera for a depth range, equally spaced in blur size.

    Where the focus moves over the field the blur of all of it counts. Arguments and errors are
    those of `learn_bank_for_camera`; `whose` says in messages what the PSFs are for.
    """
    check_levels(level_count)
    check_range_can_be_told_apart(camera, near_m, far_m)
    blur_sizes = _blur_sizes(camera, near_m, far_m, level_count)
    depths_m = camera.depth_m(blur_sizes)
    if not np.isfinite(depths_m).all():
        raise InputError(
            f"depth range {near_m:g} to {far_m:g} m: {whose} needs finite depths; far away they "
            "differ little in blur, 100 times the distance of the focus is enough"
        )
    if camera.wavefront is not None:
        return PsfStack(blur_sizes, psfs_at(camera, blur_sizes, np.zeros(2)), depths_m)
    stack = render_psf_stack(camera.mask, blur_sizes, camera.psf_diffraction_px)
    return dataclasses.replace(stack, depths_m=depths_m)


def check_range_can_be_told_apart(camera: Camera, near_m: float, far_m: float) -> None:
    """Refuse a depth range in which no two depths can be told apart, or not of the camera's side.

    An `InputError` says what to change.
    """
    span_px = float(np.ptp(camera.blur_range_px(near_m, far_m)))
    if span_px >= _MIN_SPAN_PX:
        return
    raise InputError(
        f"depth range {near_m:g} to {far_m:g} m: its ends differ by {span_px:.2g} px of blur with "
        f"the focus at {camera.focus_distance_m:g} m, so no two depths can be told apart: check "
        "the units (distances in m, mask_extent_mm in mm), or use a wider mask, a nearer focus, "
        "or a longer lens"
    )


def _blur_sizes(camera: Camera, near_m: float, far_m: float, count: int) -> DoubleArray:
    """Return equally spaced blur sizes; with the focus among them, the same on both sides of it.

    Else the side with a level just there would seem the likelier one. To have that, one end may lie
    a little beyond the range.
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
    """Learn the bank of a mask that is known from planes, for a depth range.

    The arguments are those of `learn_bank_for_camera` and `learn_bank`, and so are the errors; the
    focus must not lie within the range. The bank's depths hold whatever a camera file says.
    """
    check_levels(level_count)
    sizes_px = np.linspace(*pattern.blur_range_px(near_m, far_m), level_count)
    stack = render_psf_stack(pattern.mask, sizes_px)
    stack = dataclasses.replace(stack, depths_m=pattern.depth_m(sizes_px))
    components = pattern.components(sizes_px)
    bank = learn_bank(stack, config, prior, learned_from, components=components)
    return dataclasses.replace(bank, pattern=pattern)


def textures_of(prior: NaturalImagePrior | None) -> str:
    """Say in a few words where a prior's textures come from."""
    if isinstance(prior, EmpiricalPrior):
        return f"{len(prior.slopes)} kinds of texture from sharp images"
    return "natural-image prior"


def guarded_range(
    camera: Camera, near_m: float, far_m: float, level_count: int
) -> tuple[float, float, int]:
    """Return a depth range with one more level on either side, and its number of levels.

    What is too near or beyond the range is the most like one of these levels. Without them it
    would be taken, with full confidence, for something at the end of the range. An `InputError` if
    the range does not suit the camera.
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
