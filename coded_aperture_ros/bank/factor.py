"""The common basis: all levels' filters as combinations of a few shared ones."""

import numpy as np
import scipy.linalg
from numpy.typing import NDArray


def factor_weights(
    weights: NDArray[np.float64], scale: NDArray[np.float64], rank: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Factor ``weights ~ basis @ coefficients`` at a given rank.

    Applied to a patch, the basis costs ``K * rank`` once and every level only ``rank`` more,
    instead of ``K`` for every level (thesis 8.3.1 has the same idea for its projectors).

    Parameters
    ----------
    weights : ndarray, float64 [K, M]
        One column for every hypothesis.
    scale : ndarray, float64 [K]
        Typical power of every frequency. The approximation is best in the least-squares sense
        for spectra of this shape; without it the strongest low frequencies, whose weights are
        smallest, would be approximated worst.
    rank : int
        Number of basis vectors; limited to what the matrix has.

    Returns
    -------
    basis : ndarray, float32 [K, rank]
    coefficients : ndarray, float32 [rank, M]
    """
    scaled = weights * scale[:, None]
    # The leading left singular vectors, from the smaller problem of the Gram matrix.
    size = len(scaled)
    rank = min(rank, size)
    _, leading = scipy.linalg.eigh(scaled @ scaled.T, subset_by_index=(size - rank, size - 1))
    basis = leading / scale[:, None]
    coefficients = leading.T @ scaled
    return basis.astype(np.float32), coefficients.astype(np.float32)
