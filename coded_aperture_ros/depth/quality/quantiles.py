"""Quantiles of a few numbers."""

import numpy as np
from numpy.typing import NDArray


def quantiles(values: NDArray, *shares: float) -> NDArray:
    """Return quantiles along the first axis [shares, ...], as ``np.quantile`` does.

    That takes several times as long for a few dozen numbers, and a frame asks for many.
    """
    ordered = np.sort(values, axis=0)
    at = np.array(shares) * (len(values) - 1)
    below = at.astype(int)
    above = np.minimum(below + 1, len(values) - 1)
    part = (at - below).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(ordered[below] + part * (ordered[above] - ordered[below]))
