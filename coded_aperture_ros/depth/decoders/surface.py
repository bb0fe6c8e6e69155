"""Fractional levels: surfaces with little bending, fitted to the costs of all patches."""

import numpy as np
import scipy.sparse

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.depth.decoders.posterior import refine_level

# Cost of a second difference of one level, natural logarithm, for patches `_AT_STRIDE_PX` apart:
# the same surface bends less from patch to patch if these are nearer.
_STIFFNESS = 4.0
_AT_STRIDE_PX = 8
# Least second difference of the cost, per squared level: where a patch is uninformative, its
# neighbours' surface goes on.
_LEAST_CURVATURE = 1e-3
# Levels: patches that differ by much more are not on one surface.
_ONE_SURFACE = 0.7
# Most iterations, after which levels are within 0.01 of convergence, and the share of the squared
# residual at which they end earlier.
_ITERATIONS = 32
_SOLVED = 1e-9


def fit_surfaces(
    frame_cost: FloatArray, chosen: IndexArray, smoothness: float, stride_px: int
) -> FloatArray:
    """Fractional level of every patch, near the whole level that was chosen for it.

    The cost of each patch is expanded to second order around its minimum ``d_0`` next to the chosen
    level. The sum that is minimised is quadratic::

        sum h (d - d_0)^2  +  stiffness  sum w (d_before - 2 d + d_after)^2

    with the second difference ``h`` of the cost, which is made positive, and the weight ``w``
    of three patches in a row or a column, next to nothing where levels jump. The thesis draws
    neighbours to one depth (eq. 8.12); here slants cost nothing.

    Parameters
    ----------
    frame_cost : ndarray, float32 [rows, columns, L]
        Cost of every level by the frame alone, not bounded.
    chosen : ndarray, intp [rows, columns]
        Levels that the regularisation has chosen.
    smoothness : float
        Factor of the stiffness; 0: every patch by itself.
    stride_px : int
        Distance between patches, px.

    Returns
    -------
    ndarray, float32 [rows, columns]
        In [0, L - 1].

    References
    ----------
    Martinello 2012, section 8.3.2, eq. 8.22.
    """
    last = frame_cost.shape[-1] - 1
    if last < 2 or not smoothness:
        return refine_level(frame_cost, chosen)
    middle = np.clip(chosen, 1, last - 1)
    around = np.take_along_axis(frame_cost, middle[..., None] + np.arange(-1, 2), axis=-1)
    best = middle + around.argmin(axis=-1) - 1
    curvature = around[..., 0] - 2 * around[..., 1] + around[..., 2]
    curvature = np.maximum(curvature, np.float32(_LEAST_CURVATURE))
    stiffness = smoothness * _STIFFNESS * (_AT_STRIDE_PX / stride_px) ** 2
    matrix = _quadratic_form(curvature, chosen, stiffness)
    level = _minimum(refine_level(frame_cost, best), curvature, matrix)
    return np.clip(level, 0, last)


def _quadratic_form(
    curvature: FloatArray, chosen: IndexArray, stiffness: float
) -> scipy.sparse.dia_matrix:
    """Matrix of the quadratic form of costs and second differences [patches, patches]."""
    size, columns = chosen.size, chosen.shape[1]
    # Coupling of each patch with the one at an offset in memory.
    couplings = {
        offset: np.zeros(chosen.shape, np.float32) for offset in (0, 1, 2, columns, 2 * columns)
    }
    couplings[0] += curvature
    for axis, step in ((0, columns), (1, 1)):
        alike = np.exp(-((np.diff(chosen, axis=axis) / _ONE_SURFACE) ** 2)).swapaxes(0, axis)
        weight = stiffness * alike[:-1] * alike[1:]
        itself, next_one, next_but_one = (
            couplings[offset].swapaxes(0, axis) for offset in (0, step, 2 * step)
        )
        itself[:-2] += weight
        itself[1:-1] += 4 * weight
        itself[2:] += weight
        next_one[:-2] -= 2 * weight
        next_one[1:-1] -= 2 * weight
        next_but_one[:-2] += weight
    diagonals = np.zeros((2 * len(couplings) - 1, size), np.float32)
    offsets = [0, *(sign * offset for offset in list(couplings)[1:] for sign in (1, -1))]
    for diagonal, offset in zip(diagonals, offsets, strict=True):
        coupling = couplings[abs(offset)].ravel()[: max(size - abs(offset), 0)]
        first = max(offset, 0)
        diagonal[first : first + len(coupling)] = coupling
    return scipy.sparse.dia_matrix((diagonals, offsets), shape=(size, size))


def _minimum(
    level: FloatArray, curvature: FloatArray, matrix: scipy.sparse.dia_matrix
) -> FloatArray:
    """Level [rows, columns] that minimises the form, by preconditioned conjugate gradients."""
    found = level.ravel().copy()
    residual = curvature.ravel() * found - matrix @ found
    precision = 1 / matrix.diagonal()
    step = precision * residual
    size = first = np.vdot(residual, step)
    for _ in range(_ITERATIONS):
        if size <= _SOLVED * first:
            break
        image = matrix @ step
        length = size / np.vdot(step, image)
        found += length * step
        residual -= length * image
        conditioned = precision * residual
        before, size = size, np.vdot(residual, conditioned)
        step *= size / before
        step += conditioned
    return found.reshape(level.shape)
