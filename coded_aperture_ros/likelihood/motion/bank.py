"""Filter bank of defocus and motion together: motions as further hypotheses."""

import dataclasses

import numpy as np
import scipy.fft

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood.bank import (
    FilterBank,
    WindowedFourierBasis,
    with_all_frequencies,
)
from coded_aperture_ros.likelihood.bank.hypotheses import common_basis, fit_coefficients
from coded_aperture_ros.likelihood.motion.kernels import Motions, blurred_psf, motion_kernel
from coded_aperture_ros.optics import PsfStack

# Every second contrast of a bank: decades. Half as many hypotheses, and as exact: docs/method.md.
_EVERY_CONTRAST = 2
# Hypotheses that the common basis is made from: neighbouring ones are similar.
_BASIS_HYPOTHESES = 6000


@dataclasses.dataclass(frozen=True, eq=False)
class MotionBank:
    """Filters of every blur level under every motion.

    A motion multiplies the spectrum that a level's texture is expected to have by the square of
    its own transfer function: a product ``h_d * h_m`` (thesis eq. 7.2) is one more hypothesis of
    the likelihood in `FilterBank`, and all share one basis. The levels of `product` are all pairs:
    those of the first motion, then of the second, and so on. Without a common basis its weights
    are made of `expected` [slopes, M, L, K]: the power of texture of unit contrast, model error
    included, behind every pair.

    References
    ----------
    Martinello 2012, eq. 7.2.
    """

    defocus: FilterBank
    motions: Motions
    product: FilterBank
    expected: FloatArray

    @property
    def exact(self) -> bool:
        """Whether the common basis is that of all frequencies."""
        counts = np.count_nonzero(self.defocus.fourier.multiplicity)
        return self.product.basis_vectors >= int(counts)


def learn_motion_bank(
    bank: FilterBank, motions: Motions, rank: int = 128, progress: Progress = iter
) -> MotionBank:
    """Bank of blur levels and motions, with the PSFs, window and textures of a bank.

    Parameters
    ----------
    bank : FilterBank
        Levels of one side of the focal plane.
    motions : Motions
    rank : int
        Vectors in the common basis. As many as there are frequencies, or more, are exact: then
        the frequencies themselves are the basis.
    progress : callable, optional
        Progress callback around the iteration over motions, such as ``tqdm.tqdm``.

    Raises
    ------
    InputError
        If the longest motion and the largest PSF together do not fit the bank's window, or the
        bank has levels on both sides of the focal plane.

    References
    ----------
    Martinello 2012, eq. 7.2.

    Examples
    --------
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("disc"), [3.0, 5.0]))
    >>> learn_motion_bank(bank, Motions.grid(2, [4.0]), rank=16).product.levels
    6
    """
    if bank.stack.has_both_sides:
        raise InputError(
            "motion: the bank has levels on both sides of the focal plane, which cannot be "
            "distinguished where things move: learn a bank for one side"
        )
    bank = with_all_frequencies(bank)
    psfs, fourier = bank.stack.psfs, bank.fourier
    width = psfs.shape[-1] + len(motion_kernel((motions.longest_px, 0.0))) - 1
    if width > bank.window_px:
        raise InputError(
            f"motions of up to {motions.longest_px:g} px and PSFs of {psfs.shape[-1]} px do not "
            f"fit the bank's {bank.window_px} px window: learn a bank with a larger window, or "
            "smaller blur sizes, or take shorter motions"
        )
    prior = dataclasses.replace(bank.prior, contrasts=bank.prior.contrasts[::_EVERY_CONTRAST])
    ratios = bank.ratios[::_EVERY_CONTRAST]
    expected = expected_powers(bank, motions, progress) + np.float32(prior.model_error**2)
    shape = expected.shape[:-1]  # [slopes, M * L]
    expected = expected.reshape(-1, fourier.size)
    multiplicity = fourier.multiplicity.astype(np.float64)
    sample = expected[:: max(len(expected) // (_BASIS_HYPOTHESES // len(ratios)), 1)]
    variances = ratios[:, None, None] * sample + 1
    scales = np.exp(np.log(variances).mean(axis=1))
    scales[:, multiplicity == 0] = 1  # these have no weight in any hypothesis
    exact = rank >= np.count_nonzero(multiplicity)
    if exact:
        basis = np.eye(fourier.size)[:, multiplicity > 0]
    else:
        basis = common_basis(multiplicity / variances, scales, rank)
    basis[multiplicity == 0] = 0
    coefficients = np.empty((basis.shape[1], len(ratios), *shape), np.float32)
    log_determinants = np.empty((len(ratios), *shape), np.float32)
    for index, (ratio, scale) in enumerate(zip(ratios, scales, strict=True)):
        variance = np.float32(ratio) * expected + 1
        log_determinants[index] = (np.log(variance) @ fourier.multiplicity).reshape(shape)
        np.divide(fourier.multiplicity, variance, out=variance)
        if exact:
            fitted = variance[:, multiplicity > 0].T
        else:
            fitted = fit_coefficients(basis, variance, scale)
        coefficients[:, index] = fitted.reshape(-1, *shape)
    product = dataclasses.replace(
        bank,
        stack=_product_stack(bank.stack, motions, width),
        prior=prior,
        ratios=ratios,
        basis=basis.astype(np.float32),
        coefficients=coefficients,
        log_determinants=log_determinants,
        truncation_error=float("nan"),
        learned_from=f"{bank.learned_from}, {len(motions)} motions",
    )
    expected = expected.reshape(-1, len(motions), bank.levels, fourier.size)
    return MotionBank(bank, motions, product, expected)


def expected_powers(bank: FilterBank, motions: Motions, progress: Progress = iter) -> FloatArray:
    """Expected power of every product of motion and level [slopes, M * L, K].

    This is `WindowedFourierBasis.expected_power` in another order: the window's own spectrum
    spreads the power of each frequency over others, separably, which is a matrix from the left
    and one from the right.
    """
    n, psfs = bank.window_px, bank.stack.psfs
    period = 4 * n
    torus = (period, period)
    textures = [texture(torus) for texture in bank.prior.spectra]
    defocus = np.abs(scipy.fft.rfft2(psfs.astype(np.float64), torus)) ** 2
    spread = _spread(bank.fourier, period)
    # The power at (-v, -h) is that at (v, h): half of all frequencies, in two parts, are enough.
    half = spread[: n // 2 + 1]
    positive = half[:, : period // 2 + 1].T
    negative = np.zeros_like(positive)
    negative[1:-1] = half[:, : period // 2 : -1].T
    turned = spread[:, -np.arange(period)]
    expected = np.empty((len(textures), len(motions) * len(psfs), bank.fourier.size), np.float32)
    of_motions = expected.reshape(len(textures), len(motions), len(psfs), n, n // 2 + 1)
    for number, vector in enumerate(progress(motions.vectors_px)):
        trace = scipy.fft.rfft2(motion_kernel((vector[0], vector[1])), torus)
        for texture, out in zip(textures, of_motions[:, number], strict=True):
            blurred = (defocus * (texture * np.abs(trace) ** 2)).astype(np.float32)
            np.matmul(spread @ blurred, positive, out=out)
            out += (turned @ blurred) @ negative
    return expected


def _spread(fourier: WindowedFourierBasis, period: int) -> FloatArray:
    """Share of a torus' powers in a window's power at each frequency [N, period]."""
    n = fourier.window_px
    leakage = np.abs(scipy.fft.fft(fourier.window.astype(np.float64), period)) ** 2 / period
    index = np.arange(n)[:, None] * (period // n) - np.arange(period)
    return leakage[index % period].astype(np.float32)


def _product_stack(stack: PsfStack, motions: Motions, width_px: int) -> PsfStack:
    """PSFs of all pairs of motion and level, motion by motion."""
    psfs = [
        blurred_psf(psf, (vector[0], vector[1]), width_px)
        for vector in motions.vectors_px
        for psf in stack.psfs
    ]
    return PsfStack(
        np.tile(stack.blur_sizes_px, len(motions)), np.array(psfs), in_pixels=stack.in_pixels
    )
