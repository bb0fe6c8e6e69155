"""Learning a filter bank from the PSFs of a mask and the natural-image prior."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood.bank.empirical import EmpiricalPrior
from coded_aperture_ros.likelihood.bank.factoring import factor_weights
from coded_aperture_ros.likelihood.bank.field import FieldFilters, FieldPsfs, psfs_at
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.likelihood.bank.hypotheses import RATIOS, Hypotheses
from coded_aperture_ros.likelihood.bank.model import DEFAULT_STRIDE_PX, FilterBank
from coded_aperture_ros.likelihood.bank.pattern import LearnedPattern
from coded_aperture_ros.likelihood.bank.prior import NaturalImagePrior
from coded_aperture_ros.optics import Camera, Mask, PsfStack, render_psf_stack

# Blur levels that a depth range is divided into, unless something else is asked for.
DEFAULT_LEVEL_COUNT = 30
# On textured planes a window of 48 px is wrong by 0.1 px at a blur of 20 px, and by 0.28 px at
# 30 px, where one of 96 px is wrong by 0.06 px.
_WINDOW_PX, _ENOUGH_FOR_PX, _WINDOWS_PER_BLUR = 48, 22.0, 3.2
# Sharp pictures differ from nearly sharp ones at the highest frequencies only.
_HIGHEST_FREQUENCY, _SHARP_PX, _LOWEST_LIMIT = 0.46, 1.0, 0.1
_SMALLEST_WINDOW_PX, _LARGEST_WINDOW_PX = 16, 256
# A difference of blur that is told apart.
_LEAST_SPAN_PX = 1.0
_MOST_LEVELS = 500
# Every so many filters of the parts of an image choose the basis; it serves them all.
_BASIS_OF_PARTS = 7
# The rank that all frequencies need.
RANK_OF_ALL = 128
# A window chosen by the blur has so many patches a side, no farther apart than this.
_STRIDES_PER_WINDOW, _LARGEST_STRIDE_PX = 6, 16


@dataclasses.dataclass(frozen=True)
class LearnConfig:
    """Size and rank of a filter bank, and what is known of the camera's noise."""

    window_px: int = option(
        0,
        "Side of the patches, even. Larger is more accurate on planes, smaller is sharper at "
        "edges. 0: by the largest blur, 48 up to 22 px and 3.2 times as wide beyond.",
        unit="px",
        within=(0, _LARGEST_WINDOW_PX),
        daily=True,
    )
    rank: int = option(
        96,
        "Vectors in the common basis of the filters. Fewer is faster and less accurate.",
        within=(1, 4096),
    )
    highest_frequency: float = option(
        0.0,
        "Frequencies above this are left out: blur leaves little there that is not noise, or from "
        "edges of depth. 1: all count. 0: 0.46, or all where there is a blur below 1 px.",
        unit="cycles/px",
        within=(0.0, 1.0),
    )
    noise: float = option(
        0.0,
        "Standard deviation of the camera's noise in linear light; 0 if it is not known.",
        within=(0.0, 0.5),
        daily=True,
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.window_px % 2 or 0 < self.window_px < _SMALLEST_WINDOW_PX:
            raise InputError(
                f"window_px: expected 0 or an even number from {_SMALLEST_WINDOW_PX} on, "
                f"got {self.window_px}"
            )
        if 0 < self.highest_frequency < _LOWEST_LIMIT:
            raise InputError(
                f"highest_frequency: expected 0 or at least {_LOWEST_LIMIT:g}, "
                f"got {self.highest_frequency:g}"
            )

    def for_blur(self, largest_px: float = 0.0, widest_psf_px: int = 0) -> "LearnConfig":
        """Return it with the window that suits a blur size, unless it names one.

        The window also holds a PSF of a width: without sizes in pixels there is only that.
        """
        if self.window_px:
            return self
        window_px = _WINDOW_PX
        if largest_px > _ENOUGH_FOR_PX:
            window_px = _multiple_of_8(_WINDOWS_PER_BLUR * largest_px)
        window_px = min(max(window_px, _multiple_of_8(widest_psf_px)), _LARGEST_WINDOW_PX)
        return dataclasses.replace(self, window_px=window_px)


def _multiple_of_8(length: float) -> int:
    return 8 * int(np.ceil(length / 8))


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
    if span_px >= _LEAST_SPAN_PX:
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


def learn_bank(
    stack: PsfStack,
    config: LearnConfig | None = None,
    prior: NaturalImagePrior | None = None,
    learned_from: str = "PSFs, natural-image prior",
    mask: Mask | None = None,
    progress: Progress = iter,
    components: FloatArray | None = None,
    field: FieldPsfs | None = None,
) -> FilterBank:
    """Learn the bank that identifies the blur levels of a PSF stack.

    Parameters
    ----------
    stack : PsfStack
        One PSF for every level; at least two.
    prior : NaturalImagePrior, optional
        Hypotheses for the texture; an `EmpiricalPrior` has learned them from sharp images.
    learned_from : str, optional
        Kept in the bank for a person to read.
    mask : Mask, optional
        What the PSFs were rendered from, so that the bank is not used with another mask.
    progress : callable, optional
        Wraps the iteration over levels, as ``tqdm.tqdm`` does.
    components : ndarray, float32 [R, L, k, k], optional
        Instead of the PSFs: their autocorrelation is the sum of those of R components. The bank
        needs no more than that; see `learn_bank_from_planes`.
    field : FieldPsfs, optional
        PSFs of the same levels elsewhere in the image.

    Raises
    ------
    InputError
        If there are fewer than two levels, they are not in order, or a PSF is larger than the
        window.
    """
    prior = prior or NaturalImagePrior()
    check_levels(len(stack))
    for name, values in (("blur sizes", stack.blur_sizes_px), ("depths", stack.depths_m)):
        steps = np.diff(values if values is not None else stack.blur_sizes_px)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            raise InputError(
                f"{name}: levels must be in order, all increasing or all decreasing: sort the PSFs"
            )
    config, stride_px = _suiting(stack, config or LearnConfig())
    fourier = WindowedFourierBasis(config.window_px, config.highest_frequency)
    of_levels = stack.psfs[:, None] if components is None else components.swapaxes(0, 1)
    found = Hypotheses.of(fourier, of_levels, prior.spectra, prior.model_error, progress)
    multiplicity, weights, scales = fourier.multiplicity, found.weights, found.scales
    parts = [
        Hypotheses.of(fourier, psfs[:, None], prior.spectra, prior.model_error)
        for psfs in (progress(field.psfs) if field is not None else ())
    ]
    others = [part.weights[:, ::_BASIS_OF_PARTS] for part in parts]
    basis, coefficients = factor_weights(
        weights, scales, config.rank, np.concatenate(others, axis=1) if others else None
    )
    # Rounding leaves next to nothing there, and numbers next to nothing are slow to multiply.
    basis[multiplicity == 0] = 0
    scaled = weights * scales[:, None]
    factored = (coefficients.transpose(1, 2, 0) @ basis.T) * scales[:, None]
    return FilterBank(
        stack=stack,
        window_px=config.window_px,
        prior=prior,
        ratios=RATIOS,
        basis=basis,
        coefficients=coefficients.reshape(len(coefficients), *found.log_determinants.shape),
        log_determinants=found.log_determinants.astype(np.float32),
        truncation_error=float(np.linalg.norm(factored - scaled) / np.linalg.norm(scaled)),
        noise=config.noise,
        mask_digest=mask.digest if mask else "",
        learned_from=learned_from,
        highest_frequency=config.highest_frequency,
        stride_px=stride_px,
        field=None if field is None else FieldFilters.of(field, parts, basis),
    )


def _suiting(stack: PsfStack, config: LearnConfig) -> tuple[LearnConfig, int]:
    """Choose by the blur what settings leave open; return them, and the stride of the patches."""
    sizes_px, widest = np.abs(stack.blur_sizes_px), stack.psfs.shape[-1]
    stride_px = DEFAULT_STRIDE_PX
    if not config.window_px:
        config = config.for_blur(float(sizes_px.max()) if stack.in_pixels else 0.0, widest)
        stride_px = config.window_px // _STRIDES_PER_WINDOW // 4 * 4
        stride_px = min(max(stride_px, DEFAULT_STRIDE_PX), _LARGEST_STRIDE_PX)
    if widest > config.window_px:
        raise InputError(
            f"a PSF of {widest} px does not fit the {config.window_px} px window: "
            "use a larger window, or fewer or smaller blur sizes"
        )
    if not config.highest_frequency:
        sharp = stack.in_pixels and sizes_px.min() < _SHARP_PX
        highest = 1.0 if sharp else _HIGHEST_FREQUENCY
        config = dataclasses.replace(config, highest_frequency=highest)
    return config, stride_px


def relearned(bank: FilterBank, window_px: int, levels: IndexArray) -> FilterBank:
    """Return a bank for some levels of another, with patches of another size.

    It knows blur sizes without sign, and no depths. `levels` [n] are in the order of their sizes
    without sign: the power of a PSF is that of the PSF turned around. An `InputError` if there are
    fewer than two levels, or a PSF is larger than the window.
    """
    stack = bank.stack
    some = PsfStack(
        np.abs(stack.blur_sizes_px[levels]), stack.psfs[levels], in_pixels=stack.in_pixels
    )
    config = LearnConfig(window_px, bank.basis_vectors, bank.highest_frequency, bank.noise)
    field = None if bank.field is None else bank.field.field
    field = field and dataclasses.replace(field, psfs=field.psfs[:, levels])
    return _learned_like(bank, some, config, field)


def with_all_frequencies(bank: FilterBank) -> FilterBank:
    """Return the bank without a highest frequency: traces of motion differ at the highest, too."""
    if bank.highest_frequency >= 1:
        return bank
    config = LearnConfig(bank.window_px, RANK_OF_ALL, 1.0, bank.noise)
    other = _learned_like(bank, bank.stack, config)
    return dataclasses.replace(other, stride_px=bank.stride_px, level_error=bank.level_error)


def _learned_like(
    bank: FilterBank, stack: PsfStack, config: LearnConfig, field: FieldPsfs | None = None
) -> FilterBank:
    """Learn another bank of a bank's mask, textures and pattern."""
    components = None if bank.pattern is None else bank.pattern.components(stack.blur_sizes_px)
    other = learn_bank(
        stack, config, bank.prior, bank.learned_from, components=components, field=field
    )
    return dataclasses.replace(
        other,
        mask_digest=bank.mask_digest,
        image_width=bank.image_width,
        image_height=bank.image_height,
        setting_digest=bank.setting_digest,
        pattern=bank.pattern,
    )


def textures_of(prior: NaturalImagePrior | None) -> str:
    """Say in a few words where a prior's textures come from."""
    if isinstance(prior, EmpiricalPrior):
        return f"{len(prior.slopes)} kinds of texture from sharp images"
    return "natural-image prior"


def check_levels(count: int) -> None:
    """Refuse fewer than two levels, and so many that they would take all memory."""
    if not 2 <= count <= _MOST_LEVELS:
        allowed = "needs at least 2" if count < 2 else f"has at most {_MOST_LEVELS}"
        raise InputError(f"a bank {allowed} levels, got {count}")


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
