"""The common basis: all levels' filters as combinations of a few shared ones."""

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray


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
