"""Choosing the levels of all patches together: neighbours usually lie on one surface."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.depth.config import DepthConfig
from coded_aperture_ros.depth.levels import refine_level
from coded_aperture_ros.errors import InputError

# Evidence against a level counts up to here; beyond, it is an outlier (natural logarithm).
_ENOUGH_EVIDENCE = 6.0
# A step of more levels than this is a depth edge: how large it is no longer matters.
_EDGE_LEVELS = 4
_TV_ITERATIONS = 120


def regularized_level(
    energies: NDArray[np.float32], probability: NDArray[np.float32], config: DepthConfig
) -> NDArray[np.float32]:
    """Return the fractional level of every patch.

    Parameters
    ----------
    energies, probability : ndarray, float32 [rows, columns, L]
        See `FilterBank.energies` and `level_probability`.
    config : DepthConfig
        Says which regularisation, and how strong.

    Returns
    -------
    ndarray, float32 [rows, columns]
        In [0, L - 1].

    Raises
    ------
    InputError
        If graph cuts are asked for and PyMaxflow is not installed.
    """
    return _METHODS[config.regularize](energies, probability, config.smoothness)


def _independent(
    energies: NDArray[np.float32], probability: NDArray[np.float32], smoothness: float
) -> NDArray[np.float32]:
    return refine_level(energies, energies.argmin(axis=-1))


def _graph_cut(
    energies: NDArray[np.float32], probability: NDArray[np.float32], smoothness: float
) -> NDArray[np.float32]:
    """Alpha expansion of ``-log p + beta min(|d_p - d_q|, edge)`` (thesis eq. 6.25 and 5.24)."""
    try:
        from maxflow.fastmin import aexpansion_grid
    except ImportError as error:
        raise InputError(
            "regularize: graphcut needs PyMaxflow (pip install PyMaxflow), or choose tv or none"
        ) from error
    index = np.arange(energies.shape[-1])
    step = np.minimum(np.abs(index[:, None] - index), _EDGE_LEVELS)
    labels = aexpansion_grid(_evidence(probability), 0.4 * smoothness * step.astype(np.float64))
    return refine_level(energies, labels)


def _total_variation(
    energies: NDArray[np.float32], probability: NDArray[np.float32], smoothness: float
) -> NDArray[np.float32]:
    """Minimise ``sum (d - mean)^2 / (2 variance) + beta |grad d|`` by a primal-dual method.

    The energies enter through the mean and the variance of the level, which makes the problem
    convex; the algorithm is that of Chambolle and Pock (2011) with unit steps scaled by the norm
    of the gradient.
    """
    index = np.arange(energies.shape[-1], dtype=np.float32)
    mean = probability @ index
    variance = probability @ index**2 - mean**2 + np.float32(0.1)
    precision = 1 / variance
    level = relaxed = mean
    dual_rows = np.zeros_like(mean)
    dual_columns = np.zeros_like(mean)
    step = np.float32(1 / np.sqrt(8))
    beta = np.float32(smoothness)
    for _ in range(_TV_ITERATIONS):
        dual_rows[:-1] += step * np.diff(relaxed, axis=0)
        dual_columns[:, :-1] += step * np.diff(relaxed, axis=1)
        length = np.maximum(1, np.hypot(dual_rows, dual_columns) / max(beta, np.float32(1e-6)))
        dual_rows /= length
        dual_columns /= length
        divergence = np.diff(dual_rows, axis=0, prepend=0) + np.diff(
            dual_columns, axis=1, prepend=0
        )
        previous = level
        level = (level + step * (divergence + precision * mean)) / (1 + step * precision)
        relaxed = 2 * level - previous
    return level


def _evidence(probability: NDArray[np.float32]) -> NDArray[np.float64]:
    with np.errstate(divide="ignore"):
        return np.minimum(-np.log(probability.astype(np.float64)), _ENOUGH_EVIDENCE)


_METHODS: dict[str, Callable[..., NDArray[np.float32]]] = {
    "none": _independent,
    "graphcut": _graph_cut,
    "tv": _total_variation,
}
