"""Between whole levels: surfaces through what every patch says, bent as little as it allows."""

import numpy as np
import scipy.sparse

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.depth.decoders.posterior import refine_level

# What a bend of one level costs, beside costs in natural logarithms, for patches of
# `_AT_STRIDE_PX`: the same surface bends less from patch to patch if these are nearer.
_STIFFNESS = 4.0
_AT_STRIDE_PX = 8
# Second differences of the cost are at least this: where a patch is uninformative, the surface of
# its neighbours goes on.
_LEAST_CURVATURE = 1e-3
# Patches that differ by many more levels than this are not on one surface.
_ONE_SURFACE = 0.7
# After these the levels are within 0.01 of where they would end, or earlier, by what is left of the
# squared residual.
_ITERATIONS = 32
_SOLVED = 1e-9


def on_surfaces(
    own: FloatArray, chosen: IndexArray, smoothness: float, stride_px: int
) -> FloatArray:
    """Return fractional levels, in [0, L - 1], next to the whole ones that were chosen.

    As in thesis 8.3.2 the cost of each patch is expanded to second order (eq. 8.22), around its
    minimum ``d_0`` next to the chosen level. The sum that is minimised is quadratic::

        sum h (d - d_0)^2  +  stiffness  sum w (d_before - 2 d + d_after)^2

    with the second difference ``h`` of the cost, which is made positive, and the weight ``w``
    of three patches in a row or a column, next to nothing where levels jump. The thesis draws
    neighbours to one depth (eq. 8.12); here slants cost nothing.

    Takes each patch's own cost [rows, columns, L], not cut off, the levels that the regularisation
    has chosen [rows, columns], and a factor of the stiffness; 0: every patch for itself.
    """
    last = own.shape[-1] - 1
    if last < 2 or not smoothness:
        return refine_level(own, chosen)
    middle = np.clip(chosen, 1, last - 1)
    around = np.take_along_axis(own, middle[..., None] + np.arange(-1, 2), axis=-1)
    best = middle + around.argmin(axis=-1) - 1
    curvature = around[..., 0] - 2 * around[..., 1] + around[..., 2]
    curvature = np.maximum(curvature, np.float32(_LEAST_CURVATURE))
    stiffness = smoothness * _STIFFNESS * (_AT_STRIDE_PX / stride_px) ** 2
    matrix = _bending_beside(curvature, chosen, stiffness)
    level = _least_bent(refine_level(own, best), curvature, matrix)
    return np.clip(level, 0, last)


def _bending_beside(
    curvature: FloatArray, chosen: IndexArray, stiffness: float
) -> scipy.sparse.dia_matrix:
    """Return the matrix of the quadratic form of costs and bends [patches, patches]."""
    size, columns = chosen.size, chosen.shape[1]
    # What couples each patch with the one so many places after it, in the order of memory.
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


def _least_bent(
    level: FloatArray, curvature: FloatArray, matrix: scipy.sparse.dia_matrix
) -> FloatArray:
    """Minimise by conjugate gradients, preconditioned by the diagonal."""
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
