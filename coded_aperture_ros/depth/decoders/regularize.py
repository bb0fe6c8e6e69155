"""Spatial regularisation of levels: neighbouring patches usually lie on one surface."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.decoders.posterior import refine_level
from coded_aperture_ros.depth.decoders.semi_global import bound_outliers, semi_global_cost
from coded_aperture_ros.depth.decoders.surface import fit_surfaces

# Name of the decoder that is a network, beside `REGULARIZERS`.
LEARNED = "learned"
# Levels: larger steps are depth edges and cost no more than this one.
_EDGE_LEVELS = 4
# Weights of the smoothness beside costs in natural logarithms, for graph cut and total variation.
_CUT_BETA = 1.2
_TV_BETA = 0.6
# First and last coupling of total variation's two variables, squared levels; the iterations from
# one to the other, and primal-dual steps in each.
_TV_THETA = (10.0, 0.1)
_TV_ITERATIONS = 10
_TV_STEPS = 4


class Regularizer(Protocol):
    """Function from a cost volume to the level of every patch, smooth within surfaces.

    Examples
    --------
    >>> import numpy as np
    >>> volume = np.full((1, 2, 5), 9.0, np.float32)
    >>> volume[..., 3] = 0
    >>> regularize: Regularizer = regularizer("semiglobal")
    >>> regularize(volume, volume, None, 8).tolist()
    [[3.0, 3.0]]
    """

    def __call__(
        self,
        fused_cost: FloatArray,
        frame_cost: FloatArray,
        brightness: FloatArray | None,
        stride_px: int,
    ) -> FloatArray:
        """Fractional level of every patch.

        Parameters
        ----------
        fused_cost : ndarray, float32 [rows, columns, L]
            Cost of every level by all frames that count; see `Cost`.
        frame_cost : ndarray, float32 [rows, columns, L]
            Cost by this frame alone. It is neither bounded nor carried from the past, so that it
            locates the minimum between two levels.
        brightness : ndarray, float32 [rows, columns], or None
            Mean linear light of the frame around every patch.
        stride_px : int
            Distance between patches, px.

        Returns
        -------
        ndarray, float32 [rows, columns]
            In [0, L - 1].
        """


def regularizer(name: str, smoothness: float = 1.0) -> Regularizer:
    """Regulariser of a name in `REGULARIZERS`, with a strength relative to its default.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if name not in REGULARIZERS:
        raise InputError(f"regularize: {name!r} is not one of {', '.join(REGULARIZERS)}")
    return REGULARIZERS[name](smoothness)


def _unregularized(smoothness: float) -> Regularizer:
    """No regularisation: the likeliest level of every patch."""

    def regularize(
        fused_cost: FloatArray,
        frame_cost: FloatArray,
        brightness: FloatArray | None,
        stride_px: int,
    ) -> FloatArray:
        return refine_level(frame_cost, fused_cost.argmin(axis=-1))

    return regularize


def _total_variation(smoothness: float) -> Regularizer:
    def regularize(
        fused_cost: FloatArray,
        frame_cost: FloatArray,
        brightness: FloatArray | None,
        stride_px: int,
    ) -> FloatArray:
        return _least_variation_levels(fused_cost, smoothness)

    return regularize


def _semi_global_matching(smoothness: float) -> Regularizer:
    def regularize(
        fused_cost: FloatArray,
        frame_cost: FloatArray,
        brightness: FloatArray | None,
        stride_px: int,
    ) -> FloatArray:
        chosen = semi_global_cost(fused_cost, smoothness, brightness).argmin(axis=-1)
        return fit_surfaces(frame_cost, chosen, smoothness, stride_px)

    return regularize


def _graph_cut(smoothness: float) -> Regularizer:
    def regularize(
        fused_cost: FloatArray,
        frame_cost: FloatArray,
        brightness: FloatArray | None,
        stride_px: int,
    ) -> FloatArray:
        chosen = _least_cut_levels(fused_cost, smoothness)
        return fit_surfaces(frame_cost, chosen, smoothness, stride_px)

    return regularize


# By name: functions from a strength to a `Regularizer`. A new regulariser is entered here.
REGULARIZERS: dict[str, Callable[[float], Regularizer]] = {
    "none": _unregularized,
    "semiglobal": _semi_global_matching,
    "tv": _total_variation,
    "graphcut": _graph_cut,
}


def _least_cut_levels(volume: FloatArray, smoothness: float) -> IndexArray:
    """Level of every patch [rows, columns] by alpha expansion (thesis eq. 6.25 and 5.24).

    It minimises ``-log p + beta min(|d_p - d_q|, edge)``.
    """
    try:
        from maxflow.fastmin import aexpansion_grid
    except ImportError as error:
        raise InputError(
            "regularize: graphcut needs PyMaxflow (pip install PyMaxflow), or choose "
            "semiglobal, tv or none"
        ) from error
    index = np.arange(volume.shape[-1])
    step = np.minimum(np.abs(index[:, None] - index), _EDGE_LEVELS)
    labels = aexpansion_grid(
        np.ascontiguousarray(bound_outliers(volume), np.float64),
        _CUT_BETA * smoothness * step.astype(np.float64),
    )
    return np.asarray(labels, np.intp)


def _least_variation_levels(volume: FloatArray, smoothness: float) -> FloatArray:
    """Level of every patch [rows, columns] with the least cost and total variation.

    It minimises ``sum -log p(v) + (u - v)^2 / (2 theta) + beta |grad u|`` with theta shrinking. The
    cost is not convex in the level, total variation is: they get a variable each, which the
    coupling draws together. ``v`` is found by trying all levels, ``u`` by primal-dual steps.

    References
    ----------
    A. Chambolle and T. Pock, A first-order primal-dual algorithm for convex problems, 2011.
    """
    index = np.arange(volume.shape[-1], dtype=np.float32)
    bounded = bound_outliers(volume)
    beta = np.float32(max(_TV_BETA * smoothness, 1e-6))
    step = np.float32(1 / np.sqrt(8))  # the norm of the gradient is at most the root of 8
    smooth = relaxed = volume.argmin(axis=-1).astype(np.float32)
    dual_rows, dual_columns = np.zeros_like(smooth), np.zeros_like(smooth)
    for theta in np.geomspace(*_TV_THETA, _TV_ITERATIONS, dtype=np.float32):
        coupled = bounded + (index - smooth[..., None]) ** 2 / (2 * theta)
        best = refine_level(coupled, coupled.argmin(axis=-1))
        for _ in range(_TV_STEPS):
            dual_rows[:-1] += step * np.diff(relaxed, axis=0)
            dual_columns[:, :-1] += step * np.diff(relaxed, axis=1)
            excess = np.maximum(1, np.hypot(dual_rows, dual_columns) / beta)
            dual_rows /= excess
            dual_columns /= excess
            divergence = np.diff(dual_rows, axis=0, prepend=np.float32(0))
            divergence += np.diff(dual_columns, axis=1, prepend=np.float32(0))
            previous = smooth
            smooth = (smooth + step * (divergence + best / theta)) / (1 + step / theta)
            relaxed = 2 * smooth - previous
    # The primal-dual steps may overshoot the ends of the range.
    return np.clip(smooth, 0, index[-1])
