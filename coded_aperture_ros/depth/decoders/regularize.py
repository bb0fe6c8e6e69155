"""Choosing the levels of all patches together: neighbours usually lie on one surface."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.decoders.posterior import refine_level
from coded_aperture_ros.depth.decoders.semi_global import bound_outliers, semi_global_cost
from coded_aperture_ros.depth.decoders.surface import on_surfaces

# The choice beside `REGULARIZERS` that a network makes.
LEARNED = "learned"
# A step of more levels than this is a depth edge: how large it is no longer matters.
_EDGE_LEVELS = 4
_CUT_BETA = 1.2
_TV_BETA = 0.6
# The coupling of total variation's two variables, and the iterations that take it there.
_TV_THETA = (10.0, 0.1)
_TV_ITERATIONS = 10
_TV_STEPS = 4


class Regularizer(Protocol):
    """Chooses the level of every patch, in the light of its neighbours'."""

    def __call__(
        self, volume: FloatArray, own: FloatArray, brightness: FloatArray | None, stride_px: int
    ) -> FloatArray:
        """Return the fractional level of every patch.

        Parameters
        ----------
        volume : ndarray, float32 [rows, columns, L]
            Cost of every level, of all frames; see `Cost`.
        own : ndarray, float32 [rows, columns, L]
            Cost of this frame alone: it is not cut off and has not drifted, and tells where the
            minimum is between two levels.
        brightness : ndarray, float32 [rows, columns], or None
            Of the frame around every patch.
        stride_px : int
            Distance between patches.

        Returns
        -------
        ndarray, float32 [rows, columns]
            In [0, L - 1].
        """


def regularizer(name: str, smoothness: float = 1.0) -> Regularizer:
    """Return one of `REGULARIZERS`, of a strength relative to its default.

    Raises `InputError` if there is none of that name.
    """
    if name not in REGULARIZERS:
        raise InputError(f"regularize: {name!r} is not one of {', '.join(REGULARIZERS)}")
    return REGULARIZERS[name](smoothness)


def _by_itself(smoothness: float) -> Regularizer:
    """Every patch for itself."""
    return lambda volume, own, brightness, stride_px: refine_level(own, volume.argmin(axis=-1))


def _by_total_variation(smoothness: float) -> Regularizer:
    return lambda volume, own, brightness, stride_px: _total_variation(volume, smoothness)


def _by_semi_global_matching(smoothness: float) -> Regularizer:
    def regularize(
        volume: FloatArray, own: FloatArray, brightness: FloatArray | None, stride_px: int
    ) -> FloatArray:
        chosen = semi_global_cost(volume, smoothness, brightness).argmin(axis=-1)
        return on_surfaces(own, chosen, smoothness, stride_px)

    return regularize


def _by_graph_cut(smoothness: float) -> Regularizer:
    def regularize(
        volume: FloatArray, own: FloatArray, brightness: FloatArray | None, stride_px: int
    ) -> FloatArray:
        return on_surfaces(own, _graph_cut(volume, smoothness), smoothness, stride_px)

    return regularize


# A new one is a function from its strength to a `Regularizer`, entered here.
REGULARIZERS: dict[str, Callable[[float], Regularizer]] = {
    "none": _by_itself,
    "semiglobal": _by_semi_global_matching,
    "tv": _by_total_variation,
    "graphcut": _by_graph_cut,
}


def _graph_cut(volume: FloatArray, smoothness: float) -> IndexArray:
    """Alpha expansion of ``-log p + beta min(|d_p - d_q|, edge)`` (thesis eq. 6.25 and 5.24)."""
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


def _total_variation(volume: FloatArray, smoothness: float) -> FloatArray:
    """Minimise ``sum -log p(v) + (u - v)^2 / (2 theta) + beta |grad u|`` with theta shrinking.

    The cost is not convex in the level, total variation is: they get a variable each, which
    the coupling draws together. ``v`` is found by trying all levels, ``u`` by the primal-dual
    steps of Chambolle and Pock (2011).
    """
    index = np.arange(volume.shape[-1], dtype=np.float32)
    known = bound_outliers(volume)
    beta = np.float32(max(_TV_BETA * smoothness, 1e-6))
    step = np.float32(1 / np.sqrt(8))  # the norm of the gradient is at most the root of 8
    smooth = relaxed = volume.argmin(axis=-1).astype(np.float32)
    dual_rows, dual_columns = np.zeros_like(smooth), np.zeros_like(smooth)
    for theta in np.geomspace(*_TV_THETA, _TV_ITERATIONS, dtype=np.float32):
        coupled = known + (index - smooth[..., None]) ** 2 / (2 * theta)
        found = refine_level(coupled, coupled.argmin(axis=-1))
        for _ in range(_TV_STEPS):
            dual_rows[:-1] += step * np.diff(relaxed, axis=0)
            dual_columns[:, :-1] += step * np.diff(relaxed, axis=1)
            excess = np.maximum(1, np.hypot(dual_rows, dual_columns) / beta)
            dual_rows /= excess
            dual_columns /= excess
            divergence = np.diff(dual_rows, axis=0, prepend=np.float32(0))
            divergence += np.diff(dual_columns, axis=1, prepend=np.float32(0))
            previous = smooth
            smooth = (smooth + step * (divergence + found / theta)) / (1 + step / theta)
            relaxed = 2 * smooth - previous
    # The primal-dual steps may overshoot the ends of the range.
    return np.clip(smooth, 0, index[-1])
