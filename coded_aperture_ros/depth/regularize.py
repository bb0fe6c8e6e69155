"""Choosing the levels of all patches together: neighbours usually lie on one surface."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank import DEFAULT_STRIDE_PX
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.config import DepthConfig
from coded_aperture_ros.depth.levels import refine_level
from coded_aperture_ros.depth.surface import on_surfaces

# Evidence against a level counts up to here; beyond, it is an outlier (natural logarithm).
_ENOUGH_EVIDENCE = 7.0
# A step of more levels than this is a depth edge: how large it is no longer matters.
_EDGE_LEVELS = 4
# Weights of the smoothness beside natural-logarithm evidence.
_SLIGHT_STEP = 4.0
_JUMP = 22.0
_CUT_BETA = 1.2
_TV_BETA = 0.6
# The coupling of total variation's two variables, and the iterations that take it there.
_TV_THETA = (10.0, 0.1)
_TV_ITERATIONS = 10
_TV_STEPS = 4
# Where the brightness changes by much more than usual, smoothness counts only this share.
_ACROSS_CONTRAST = 0.3


def regularized_level(
    evidence: NDArray[np.float32],
    config: DepthConfig,
    brightness: NDArray[np.float32] | None = None,
    own: NDArray[np.float32] | None = None,
    stride_px: int = DEFAULT_STRIDE_PX,
) -> NDArray[np.float32]:
    """Return the fractional level of every patch.

    A whole level is chosen for each, and with neighbours then a surface through these, see
    `on_surfaces`; `tv` does both at once.

    Parameters
    ----------
    evidence : ndarray, float32 [rows, columns, L]
        Against every level; see `level_evidence`.
    config : DepthConfig
        Says which regularisation, and how strong.
    brightness : ndarray, float32 [rows, columns], optional
        Of the frame at every patch: `semiglobal` lets levels jump more easily where it changes.
    own : ndarray, float32 [rows, columns, L], optional
        The evidence of one frame, where `evidence` is that of several: it is not cut off and has
        not drifted, and tells where the minimum is between two levels. Not for `tv`.
    stride_px : int, optional
        Distance between patches.

    Returns
    -------
    ndarray, float32 [rows, columns]
        In [0, L - 1].

    Raises
    ------
    InputError
        If graph cuts are asked for and PyMaxflow is not installed.
    """
    if config.regularize == "tv":
        return _total_variation(evidence, config.smoothness)
    own = evidence if own is None else own
    if config.regularize == "none":
        return refine_level(own, evidence.argmin(axis=-1))
    if config.regularize == "graphcut":
        chosen = _graph_cut(evidence, config.smoothness)
    else:
        chosen = _semi_global(evidence, config.smoothness, brightness)
    return on_surfaces(own, chosen, config.smoothness, stride_px)


def _semi_global(
    evidence: NDArray[np.float32],
    smoothness: float,
    brightness: NDArray[np.float32] | None,
) -> NDArray[np.intp]:
    """Minimise along rows and columns, both ways, and add up (Hirschmueller, 2008).

    Each of the four paths through a patch is minimised exactly, with a small cost for steps of
    one level, as of slants, and a larger one for jumps.
    """
    known = _bounded(evidence)
    rows, columns = known.shape[:2]
    down = np.full((rows - 1, columns), smoothness, np.float32)
    across = np.full((columns - 1, rows), smoothness, np.float32)
    if brightness is not None and brightness.size > 1:
        changes = [np.abs(np.diff(brightness, axis=axis)) for axis in (0, 1)]
        usual = np.median(np.concatenate([change.ravel() for change in changes]))
        weights = [
            _ACROSS_CONTRAST + (1 - _ACROSS_CONTRAST) * np.exp(-((change / max(usual, 1e-6)) ** 2))
            for change in changes
        ]
        mean = np.mean(np.concatenate([weight.ravel() for weight in weights]))
        down *= weights[0] / mean
        across *= weights[1].T / mean
    # Every path counts the evidence of its patch.
    total = _both_ways(known, down) - 3 * known
    total += _both_ways(known.swapaxes(0, 1), across).swapaxes(0, 1)
    return np.asarray(total.argmin(axis=-1))


def _both_ways(evidence: NDArray[np.float32], weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Add up the costs of the best paths that reach each patch along the first axis.

    Takes [n, m, L] and the weight of the smoothness between neighbours [n - 1, m].
    """
    # Levels before patches: all that is done to every level is then one long run of numbers.
    costs = np.empty((len(evidence), 2, evidence.shape[2], evidence.shape[1]), np.float32)
    costs[:, 0] = evidence.swapaxes(1, 2)
    costs[:, 1] = costs[::-1, 0]
    slight = _SLIGHT_STEP * np.stack([weights, weights[::-1]], axis=1)[:, :, None]
    jump = _JUMP / _SLIGHT_STEP * slight
    step, best = np.empty_like(costs[0]), np.empty_like(costs[0])
    least = np.empty_like(costs[0, :, :1])
    for i in range(1, len(costs)):
        previous = costs[i - 1]
        np.minimum.reduce(previous, axis=1, keepdims=True, out=least)
        np.subtract(previous, least, out=previous)  # so that costs do not grow along the path
        np.minimum(previous, jump[i - 1], out=best)
        np.add(previous, slight[i - 1], out=step)
        np.minimum(best[:, 1:], step[:, :-1], out=best[:, 1:])
        np.minimum(best[:, :-1], step[:, 1:], out=best[:, :-1])
        np.add(costs[i], best, out=costs[i])
    return (costs[:, 0] + costs[::-1, 1]).swapaxes(1, 2)


def _graph_cut(evidence: NDArray[np.float32], smoothness: float) -> NDArray[np.intp]:
    """Alpha expansion of ``-log p + beta min(|d_p - d_q|, edge)`` (thesis eq. 6.25 and 5.24)."""
    try:
        from maxflow.fastmin import aexpansion_grid
    except ImportError as error:
        raise InputError(
            "regularize: graphcut needs PyMaxflow (pip install PyMaxflow), or choose "
            "semiglobal, tv or none"
        ) from error
    index = np.arange(evidence.shape[-1])
    step = np.minimum(np.abs(index[:, None] - index), _EDGE_LEVELS)
    labels = aexpansion_grid(
        np.ascontiguousarray(_bounded(evidence), np.float64),
        _CUT_BETA * smoothness * step.astype(np.float64),
    )
    return np.asarray(labels, np.intp)


def _total_variation(evidence: NDArray[np.float32], smoothness: float) -> NDArray[np.float32]:
    """Minimise ``sum -log p(v) + (u - v)^2 / (2 theta) + beta |grad u|`` with theta shrinking.

    The evidence is not convex in the level, total variation is: they get a variable each, which
    the coupling draws together. ``v`` is found by trying all levels, ``u`` by the primal-dual
    steps of Chambolle and Pock (2011).
    """
    index = np.arange(evidence.shape[-1], dtype=np.float32)
    known = _bounded(evidence)
    beta = np.float32(max(_TV_BETA * smoothness, 1e-6))
    step = np.float32(1 / np.sqrt(8))  # the norm of the gradient is at most the root of 8
    smooth = relaxed = evidence.argmin(axis=-1).astype(np.float32)
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


def _bounded(evidence: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the negative logarithm of the probability, up to where it is an outlier's."""
    of_all = np.log(np.exp(-evidence).sum(axis=-1, keepdims=True))
    return np.minimum(evidence + of_all, np.float32(_ENOUGH_EVIDENCE))
