"""Learning a filter bank from PSFs and a prior of sharp texture."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood.bank.field import FieldFilters, FieldPsfs
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.likelihood.bank.hypotheses import RATIOS, FilterHypotheses, factor_weights
from coded_aperture_ros.likelihood.bank.measured import prior_for_measured_psfs
from coded_aperture_ros.likelihood.bank.model import (
    DEFAULT_STRIDE_PX,
    FilterBank,
    check_level_count,
)
from coded_aperture_ros.likelihood.bank.prior import NaturalImagePrior
from coded_aperture_ros.optics import Mask, PsfStack

# Default side of the patches, px, and the largest blur that it suits, px. On textured planes a
# window of 48 px is wrong by 0.1 px at a blur of 20 px, and by 0.28 px at 30 px, where one of 96 px
# is wrong by 0.06 px.
_WINDOW_PX = 48
_MAX_BLUR_OF_WINDOW_PX = 22.0
# Side of the patches over the largest blur, where that is larger.
_WINDOWS_PER_BLUR = 3.2
_MIN_WINDOW_PX = 16
_MAX_WINDOW_PX = 256
# Default highest frequency, cycles per pixel; all count where a blur is less than `_SHARP_PX`:
# sharp pictures differ from nearly sharp ones at the highest frequencies only.
_HIGHEST_FREQUENCY = 0.46
_SHARP_PX = 1.0
_MIN_HIGHEST_FREQUENCY = 0.1
# Every so many filters of the parts of an image choose the basis; it serves them all.
_BASIS_OF_PARTS = 7
# A window chosen by the blur has so many patches a side, no farther apart than this, px.
_STRIDES_PER_WINDOW = 6
_MAX_STRIDE_PX = 16


@dataclasses.dataclass(frozen=True)
class LearnConfig:
    """Size and rank of a filter bank, and the noise of the camera.

    Examples
    --------
    >>> LearnConfig().for_blur(30.0).window_px
    96
    """

    window_px: int = option(
        0,
        "Side of the patches, even. Larger is more accurate on planes, smaller is sharper at "
        "edges. 0: by the largest blur, 48 up to 22 px and 3.2 times as wide beyond.",
        unit="px",
        within=(0, _MAX_WINDOW_PX),
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
        if self.window_px % 2 or 0 < self.window_px < _MIN_WINDOW_PX:
            raise InputError(
                f"window_px: expected 0 or an even number from {_MIN_WINDOW_PX} on, "
                f"got {self.window_px}"
            )
        if 0 < self.highest_frequency < _MIN_HIGHEST_FREQUENCY:
            raise InputError(
                f"highest_frequency: expected 0 or at least {_MIN_HIGHEST_FREQUENCY:g}, "
                f"got {self.highest_frequency:g}"
            )

    def for_blur(self, largest_px: float = 0.0, widest_psf_px: int = 0) -> "LearnConfig":
        """Settings with the window for a blur size, unless a window is set.

        Parameters
        ----------
        largest_px : float
            Largest blur size, px; 0 if it is unknown.
        widest_psf_px : int
            Width of the widest PSF, px, which the window holds, too.
        """
        if self.window_px:
            return self
        window_px = _WINDOW_PX
        if largest_px > _MAX_BLUR_OF_WINDOW_PX:
            window_px = _multiple_of_8(_WINDOWS_PER_BLUR * largest_px)
        window_px = min(max(window_px, _multiple_of_8(widest_psf_px)), _MAX_WINDOW_PX)
        return dataclasses.replace(self, window_px=window_px)


def _multiple_of_8(length: float) -> int:
    """Smallest multiple of 8 that is not less than a length."""
    return 8 * int(np.ceil(length / 8))


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
    """Filter bank of the blur levels of a PSF stack.

    Parameters
    ----------
    stack : PsfStack
        One PSF for every level, at least two, in order of size.
    config : LearnConfig, optional
    prior : NaturalImagePrior, optional
        Hypotheses for the texture; an `EmpiricalPrior` has learned them from sharp images.
    learned_from : str, optional
        Origin of the PSFs, kept in the bank for a person to read.
    mask : Mask, optional
        Mask that the PSFs were rendered from, so that the bank is not used with another mask.
    progress : callable, optional
        Progress callback around the iteration over levels, such as ``tqdm.tqdm``.
    components : ndarray, float32 [R, L, k, k], optional
        R components whose autocorrelations add up to those of the PSFs, and replace these; see
        `learn_bank_from_planes`.
    field : FieldPsfs, optional
        PSFs of the same levels elsewhere in the image.

    Raises
    ------
    InputError
        If there are fewer than two levels, they are not in order, or a PSF is larger than the
        window.

    References
    ----------
    Martinello 2012, chapter 6 and section 8.3.1.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("disc"), [3.0, 5.0, 7.0]))
    >>> bank.levels, bank.window_px, bank.basis.shape
    (3, 48, (1200, 96))
    """
    prior = prior or NaturalImagePrior()
    if stack.nominal or not stack.in_pixels:  # nobody has rendered these
        prior = prior_for_measured_psfs(prior)
    check_level_count(len(stack))
    for name, values in (("blur sizes", stack.blur_sizes_px), ("depths", stack.depths_m)):
        steps = np.diff(values if values is not None else stack.blur_sizes_px)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            raise InputError(
                f"{name}: levels must be in order, all increasing or all decreasing: sort the PSFs"
            )
    config, stride_px = _complete_config(stack, config or LearnConfig())
    fourier = WindowedFourierBasis(config.window_px, config.highest_frequency)
    psfs = stack.psfs[:, None] if components is None else components.swapaxes(0, 1)
    found = FilterHypotheses.compute(fourier, psfs, prior.spectra, prior.model_error, progress)
    multiplicity, weights, scales = fourier.multiplicity, found.weights, found.scales
    parts = [
        FilterHypotheses.compute(fourier, of_part[:, None], prior.spectra, prior.model_error)
        for of_part in (progress(field.psfs) if field is not None else ())
    ]
    others = [part.weights[:, ::_BASIS_OF_PARTS] for part in parts]
    basis, coefficients = factor_weights(
        weights, scales, config.rank, np.concatenate(others, axis=1) if others else None
    )
    # Rounding leaves next to nothing there, and numbers next to nothing are slow to multiply.
    basis[multiplicity == 0] = 0
    scaled = weights * scales[:, None]
    factored = (coefficients.transpose(1, 2, 0) @ basis.T) * scales[:, None]
    bank = FilterBank(
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
        field=None if field is None else FieldFilters.fit(field, parts, basis),
    )
    return with_channels(bank)


def with_channels(bank: FilterBank) -> FilterBank:
    """Bank with those of its colour channels, if their PSFs differ; else the bank itself."""
    psfs = bank.stack.channel_psfs
    if psfs is None:
        return bank
    config = LearnConfig(bank.window_px, bank.basis_vectors, bank.highest_frequency, bank.noise)
    stacks = [dataclasses.replace(bank.stack, psfs=one, channel_psfs=None) for one in psfs]
    channels = tuple(learn_like(bank, stack, config) for stack in stacks)
    return dataclasses.replace(bank, channels=channels)


def _complete_config(stack: PsfStack, config: LearnConfig) -> tuple[LearnConfig, int]:
    """Settings with window and highest frequency by the blur, and the stride of patches, px."""
    sizes_px, widest = np.abs(stack.blur_sizes_px), stack.psfs.shape[-1]
    stride_px = DEFAULT_STRIDE_PX
    if not config.window_px:
        config = config.for_blur(float(sizes_px.max()) if stack.in_pixels else 0.0, widest)
        stride_px = config.window_px // _STRIDES_PER_WINDOW // 4 * 4
        stride_px = min(max(stride_px, DEFAULT_STRIDE_PX), _MAX_STRIDE_PX)
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


def relearn_bank(bank: FilterBank, window_px: int, levels: IndexArray) -> FilterBank:
    """Bank of n levels of another, with patches of another size.

    Its blur sizes have no sign, as the power of a PSF is that of the PSF turned around, and it has
    no depths.

    Parameters
    ----------
    bank : FilterBank
    window_px : int
        Side of the patches, px.
    levels : ndarray, int [n]
        Indices of the bank's levels, in order of their sizes without sign.

    Raises
    ------
    InputError
        If there are fewer than two levels, or a PSF is larger than the window.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("disc"), [3.0, 5.0, 7.0]))
    >>> relearn_bank(bank, 32, np.array([0, 2])).blur_sizes_px.tolist()
    [3.0, 7.0]
    """
    stack = bank.stack
    channels = stack.channel_psfs
    chosen = PsfStack(
        np.abs(stack.blur_sizes_px[levels]),
        stack.psfs[levels],
        in_pixels=stack.in_pixels,
        channel_psfs=None if channels is None else channels[:, levels],
    )
    config = LearnConfig(window_px, bank.basis_vectors, bank.highest_frequency, bank.noise)
    field = None if bank.field is None else bank.field.field
    field = field and dataclasses.replace(field, psfs=field.psfs[:, levels])
    return learn_like(bank, chosen, config, field)


def learn_like(
    bank: FilterBank, stack: PsfStack, config: LearnConfig, field: FieldPsfs | None = None
) -> FilterBank:
    """Bank of other levels of a bank's mask, with the same textures and pattern."""
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
