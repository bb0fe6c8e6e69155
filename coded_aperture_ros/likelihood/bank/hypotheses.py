"""What patches look like under every hypothesis: kind of texture, level, contrast over noise."""

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
class Hypotheses:
    """Filters for the power of a patch; see `FilterBank`.

    Attributes
    ----------
    weights : ndarray, float64 [S, kinds * L, K]
        ``m / V``.
    scales : ndarray, float64 [S, K]
        The typical power of every frequency; 1 where none counts.
    log_determinants : ndarray, float64 [S, kinds, L]
        ``sum_k m_k log V_k``.
    """

    weights: DoubleArray
    scales: DoubleArray
    log_determinants: DoubleArray

    @classmethod
    def of(
        cls,
        fourier: WindowedFourierBasis,
        of_levels: FloatArray,
        textures: Sequence[Callable[[tuple[int, int]], DoubleArray]],
        model_error: float,
        progress: Progress = iter,
    ) -> "Hypotheses":
        """Compute them for PSFs [L, R, k, k], whose R parts add up, and kinds of texture."""
        expected = np.array(
            [
                [sum(fourier.expected_power(psf, texture) for psf in psfs) for texture in textures]
                for psfs in progress(of_levels)
            ]
        )  # [L, kinds, K]
        expected = expected.transpose(1, 0, 2) + model_error**2
        variances = RATIOS[:, None, None, None] * expected + 1  # [S, kinds, L, K]
        log_variances = np.log(variances)
        multiplicity = fourier.multiplicity.astype(np.float64)
        all_of_them = (len(RATIOS), -1, fourier.size)
        scales = np.exp(log_variances.reshape(all_of_them).mean(axis=1))
        scales[:, multiplicity == 0] = 1  # these have no weight at any level
        weights = (multiplicity / variances).reshape(all_of_them)
        return cls(weights, scales, log_variances @ multiplicity)


def factor_weights(
    weights: DoubleArray, scales: DoubleArray, rank: int, others: DoubleArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Factor ``weights ~ basis @ coefficients`` at a given rank.

    Applied to a patch, the basis costs ``K * rank`` once and every level only ``rank`` more,
    instead of ``K`` for every level (thesis 8.3.1 has the same idea for its projectors).

    `weights`, float64 [S, M, K], are a filter for every one of M hypotheses under each of S ratios
    of contrast to noise; `scales`, float64 [S, K], the typical power of every frequency under each
    ratio. The approximation is best in the least-squares sense for spectra of this shape; without
    it the strongest low frequencies, whose weights are smallest, would be approximated worst. The
    rank is limited to what the filters need. The basis is made for `others` [S, N, K], too. Returns
    the basis [K, rank] and the coefficients [rank, S, M], float32.
    """
    of = weights if others is None else np.concatenate([weights, others], axis=1)
    basis = common_basis(of, scales, rank)
    # One basis serves all ratios, but each fits its coefficients to its own spectra: without
    # noise the power of the frequencies spans many decades more than with it.
    coefficients = [
        fitted_coefficients(basis, filters, scale)
        for filters, scale in zip(weights, scales, strict=True)
    ]
    return basis.astype(np.float32), np.stack(coefficients, axis=1).astype(np.float32)


def common_basis(weights: DoubleArray, scales: DoubleArray, rank: int) -> DoubleArray:
    """Return the basis [K, rank] of `factor_weights`."""
    common = np.exp(np.log(scales).mean(axis=0))
    leading = _leading_vectors(weights.reshape(-1, len(common)).T * common[:, None], rank)
    return leading / common[:, None]


def fitted_coefficients(
    basis: DoubleArray, filters: NDArray[np.floating], scale: DoubleArray
) -> DoubleArray:
    """Return the coefficients [rank, M] of filters [M, K] in a basis, for spectra like `scale`."""
    scaled = basis * scale[:, None]
    return scipy.linalg.lstsq(scaled, (filters * scale).T, cond=1e-9)[0]


def _leading_vectors(matrix: DoubleArray, rank: int) -> DoubleArray:
    """Return the leading left singular vectors, from the smaller of the two Gram matrices."""
    tall = matrix.shape[0] > matrix.shape[1]
    gram = matrix.T @ matrix if tall else matrix @ matrix.T
    rank = min(rank, len(gram))
    _, vectors = scipy.linalg.eigh(gram, subset_by_index=(len(gram) - rank, len(gram) - 1))
    if not tall:
        return vectors
    # The smallest of them are inexact this way; what counts is the space that they span.
    return np.linalg.qr(matrix @ vectors[:, ::-1])[0]
