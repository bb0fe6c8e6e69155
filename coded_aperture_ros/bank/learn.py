"""Learning a filter bank from the PSFs of a mask and the natural-image prior."""

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from coded_aperture_ros.bank.bank import FilterBank
from coded_aperture_ros.bank.factor import factor_weights
from coded_aperture_ros.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.bank.prior import NaturalImagePrior
from coded_aperture_ros.configuration import check_options, option
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.optics import Camera, Mask, PsfStack, render_psf_stack

# Contrast over noise variance: contrasts of 1e-5 to 0.1 under noise of 0.0002 to 0.01.
RATIOS = 10.0 ** (np.arange(-2, 14) / 2)


@dataclasses.dataclass(frozen=True)
class LearnConfig:
    """Size and rank of a filter bank, and what is known of the camera's noise."""

    window_px: int = option(
        48,
        "Side of the patches. Larger is more accurate on planes, smaller is sharper at edges.",
        unit="px",
        minimum=16,
        maximum=256,
    )
    rank: int = option(
        128,
        "Vectors in the common basis of the filters. Fewer is faster and less accurate.",
        minimum=1,
        maximum=4096,
    )
    noise: float = option(
        0.0,
        "Standard deviation of the camera's noise in linear light; 0 if it is not known.",
        minimum=0.0,
        maximum=0.5,
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.window_px % 2:
            raise InputError(f"window_px: expected an even number, got {self.window_px}")


def learn_bank_for_camera(
    camera: Camera,
    near_m: float,
    far_m: float,
    levels: int,
    config: LearnConfig | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> FilterBank:
    """Learn the bank of a camera for a depth range, from its mask alone.

    Parameters
    ----------
    camera : Camera
    near_m, far_m : float
        Depth range, metres.
    levels : int
        Number of levels, equally spaced in blur size; at least 2.
    config, progress
        See `learn_bank`.

    Raises
    ------
    InputError
        If the range does not lie on the camera's side of the focal plane or ends at infinity,
        there are fewer than two levels, or a blur size does not fit the window.
    """
    _check_levels(levels)
    blur_sizes = np.linspace(*camera.blur_range_px(near_m, far_m), levels)
    depths_m = camera.depth_m(blur_sizes)
    if not np.isfinite(depths_m).all():
        raise InputError(
            f"depth range {near_m:g} to {far_m:g} m: a bank needs finite depths; far away they "
            "differ little in blur, 100 times the distance of the focus is enough"
        )
    stack = dataclasses.replace(render_psf_stack(camera.mask, blur_sizes), depths_m=depths_m)
    learned_from = f"mask {camera.mask.name}, {near_m:g} to {far_m:g} m, natural-image prior"
    return learn_bank(stack, config, learned_from=learned_from, mask=camera.mask, progress=progress)


def learn_bank(
    stack: PsfStack,
    config: LearnConfig | None = None,
    prior: NaturalImagePrior | None = None,
    learned_from: str = "PSFs, natural-image prior",
    mask: Mask | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> FilterBank:
    """Learn the bank that identifies the blur levels of a PSF stack.

    Parameters
    ----------
    stack : PsfStack
        One PSF for every level; at least two.
    config : LearnConfig, optional
    prior : NaturalImagePrior, optional
    learned_from : str, optional
        Kept in the bank for a person to read.
    mask : Mask, optional
        What the PSFs were rendered from, so that the bank is not used with another mask.
    progress : callable, optional
        Wraps the iteration over levels, as ``tqdm.tqdm`` does.

    Returns
    -------
    FilterBank

    Raises
    ------
    InputError
        If there are fewer than two levels, they are not in order, or a PSF is larger than the
        window.
    """
    config = config or LearnConfig()
    prior = prior or NaturalImagePrior()
    _check_levels(len(stack))
    for name, values in (("blur sizes", stack.blur_sizes_px), ("depths", stack.depths_m)):
        steps = np.diff(values if values is not None else stack.blur_sizes_px)
        if not (np.all(steps > 0) or np.all(steps < 0)):
            raise InputError(
                f"{name}: levels must be in order, all increasing or all decreasing: sort the PSFs"
            )
    widest = stack.psfs.shape[-1]
    if widest > config.window_px:
        raise InputError(
            f"a PSF of {widest} px does not fit the {config.window_px} px window: "
            "use a larger window, or fewer or smaller blur sizes"
        )
    fourier = WindowedFourierBasis(config.window_px)
    expected = np.array(
        [
            [fourier.expected_power(psf, slope) for slope in prior.slopes]
            for psf in progress(stack.psfs)
        ]
    )  # [L, slopes, K]
    expected = expected.transpose(1, 0, 2) + prior.model_error**2
    variances = RATIOS[:, None, None, None] * expected + 1  # [S, slopes, L, K]
    log_variances = np.log(variances)
    multiplicity = fourier.multiplicity.astype(np.float64)
    weights = (multiplicity / variances).reshape(-1, fourier.size).T
    scale = np.exp(log_variances.mean(axis=(0, 1, 2)))
    scale[multiplicity == 0] = 1  # these have no weight at any level
    basis, coefficients = factor_weights(weights, scale, config.rank)
    residual = (basis @ coefficients - weights) * scale[:, None]
    return FilterBank(
        stack=stack,
        window_px=config.window_px,
        prior=prior,
        ratios=RATIOS,
        basis=basis,
        coefficients=coefficients.reshape(len(coefficients), *variances.shape[:-1]),
        log_determinants=(log_variances @ multiplicity).astype(np.float32),
        truncation_error=float(np.linalg.norm(residual) / np.linalg.norm(weights * scale[:, None])),
        noise=config.noise,
        mask_digest=mask.digest if mask else "",
        learned_from=learned_from,
    )


def _check_levels(count: int) -> None:
    if count < 2:
        raise InputError(f"a bank needs at least 2 levels, got {count}")
