"""Filters of every hypothesis (kind of texture, level, contrast over noise) and their basis."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis

# Contrast over noise variance: contrasts of 1e-5 to 0.1 under noise of 0.0002 to 0.01.
RATIOS = 10.0 ** (np.arange(-2, 14) / 2)


@dataclasses.dataclass(frozen=True, eq=False)
class FilterHypotheses:
    """Filters for the power of a patch; see `FilterBank`."""

    weights: DoubleArray  # [S, kinds * L, K]; ``m / V``
    scales: DoubleArray  # [S, K]; typical power of every frequency, 1 where none counts
    log_determinants: DoubleArray  # [S, kinds, L]; ``sum_k m_k log V_k``

    @classmethod
    def compute(
        cls,
        fourier: WindowedFourierBasis,
        psfs: FloatArray,
        textures: Sequence[Callable[[tuple[int, int]], DoubleArray]],
        model_error: float,
        progress: Progress = iter,
    ) -> "FilterHypotheses":
        """Filters of PSFs and kinds of texture.

        Parameters
        ----------
        fourier : WindowedFourierBasis
        psfs : ndarray, float32 [L, R, k, k]
            The powers of the R parts of a level add up.
        textures : sequence of callable
            Power spectra as functions of an image's shape; see `NaturalImagePrior.spectra`.
        model_error : float
            See `NaturalImagePrior`.
        progress : callable, optional
            Progress callback around the iteration over levels.
        """
        expected = np.array(
            [
                [sum(fourier.expected_power(psf, texture) for psf in parts) for texture in textures]
                for parts in progress(psfs)
            ]
        )  # [L, kinds, K]
        expected = expected.transpose(1, 0, 2) + model_error**2
        variances = RATIOS[:, None, None, None] * expected + 1  # [S, kinds, L, K]
        log_variances = np.log(variances)
        multiplicity = fourier.multiplicity.astype(np.float64)
        shape = (len(RATIOS), -1, fourier.size)
        scales = np.exp(log_variances.reshape(shape).mean(axis=1))
        scales[:, multiplicity == 0] = 1  # these have no weight at any level
        weights = (multiplicity / variances).reshape(shape)
        return cls(weights, scales, log_variances @ multiplicity)


def factor_weights(
    weights: DoubleArray, scales: DoubleArray, rank: int, others: DoubleArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Common basis [K, rank] and coefficients [rank, S, M], float32, of filters.

    They factor ``weights ~ basis @ coefficients``. Applied to a patch, the basis costs ``K * rank``
    once and every level only ``rank`` more, instead of ``K`` for every level. The approximation is
    best in the least-squares sense for spectra like `scales`; without those, the strongest low
    frequencies, whose weights are smallest, would be approximated worst.

    Parameters
    ----------
    weights : ndarray, float64 [S, M, K]
        A filter for every one of M hypotheses under each of S ratios of contrast to noise.
    scales : ndarray, float64 [S, K]
        Typical power of every frequency under each ratio.
    rank : int
        Limited to what the filters need.
    others : ndarray, float64 [S, N, K], optional
        Further filters that the basis is made for.

    References
    ----------
    Martinello 2012, section 8.3.1, has the same idea for its projectors.
    """
    filters_of_basis = weights if others is None else np.concatenate([weights, others], axis=1)
    basis = common_basis(filters_of_basis, scales, rank)
    # One basis serves all ratios, but each fits its coefficients to its own spectra: without
    # noise the power of the frequencies spans many decades more than with it.
    coefficients = [
        fit_coefficients(basis, filters, scale)
        for filters, scale in zip(weights, scales, strict=True)
    ]
    return basis.astype(np.float32), np.stack(coefficients, axis=1).astype(np.float32)


def common_basis(weights: DoubleArray, scales: DoubleArray, rank: int) -> DoubleArray:
    """Basis [K, rank] of `factor_weights`."""
    common = np.exp(np.log(scales).mean(axis=0))
    leading = _leading_vectors(weights.reshape(-1, len(common)).T * common[:, None], rank)
    return leading / common[:, None]


def fit_coefficients(
    basis: DoubleArray, filters: NDArray[np.floating], scale: DoubleArray
) -> DoubleArray:
    """Coefficients [rank, M] of filters [M, K] in a basis, for spectra like `scale` [K]."""
    scaled = basis * scale[:, None]
    return scipy.linalg.lstsq(scaled, (filters * scale).T, cond=1e-9)[0]


def _leading_vectors(matrix: DoubleArray, rank: int) -> DoubleArray:
    """Leading left singular vectors, from the smaller of the two Gram matrices."""
    tall = matrix.shape[0] > matrix.shape[1]
    gram = matrix.T @ matrix if tall else matrix @ matrix.T
    rank = min(rank, len(gram))
    _, vectors = scipy.linalg.eigh(gram, subset_by_index=(len(gram) - rank, len(gram) - 1))
    if not tall:
        return vectors
    # The smallest of them are inexact this way; what counts is the space that they span.
    return np.linalg.qr(matrix @ vectors[:, ::-1])[0]
