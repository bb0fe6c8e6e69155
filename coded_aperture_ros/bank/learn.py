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
from coded_aperture_ros.optics import PsfStack

# Contrast over noise variance: contrasts of 1e-5 to 0.1 under noise of 0.0002 to 0.01.
RATIOS = 10.0 ** (np.arange(-2, 14) / 2)


@dataclasses.dataclass(frozen=True)
class LearnConfig:
    """Size and rank of a filter bank."""

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

    def __post_init__(self) -> None:
        check_options(self)
        if self.window_px % 2:
            raise InputError(f"window_px: expected an even number, got {self.window_px}")


def learn_bank(
    stack: PsfStack,
    config: LearnConfig | None = None,
    prior: NaturalImagePrior | None = None,
    learned_from: str = "PSF stack and natural-image prior",
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
    progress : callable, optional
        Wraps the iteration over levels, as ``tqdm.tqdm`` does.

    Returns
    -------
    FilterBank

    Raises
    ------
    InputError
        If there are fewer than two levels, or a PSF is larger than the window.
    """
    config = config or LearnConfig()
    prior = prior or NaturalImagePrior()
    if len(stack.psfs) < 2:
        raise InputError(f"a bank needs at least 2 levels, got {len(stack.psfs)}")
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
        learned_from=learned_from,
    )
