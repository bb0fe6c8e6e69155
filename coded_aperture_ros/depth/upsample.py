"""From the coarse grid of patches to a map of the wanted size, without mixing across edges."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank import PatchGrid

# Levels that differ by more lie on two sides of a depth edge and are not averaged.
_SAME_SURFACE = 1.5


def upsample(
    level: NDArray[np.float32],
    confidence: NDArray[np.float32],
    grid: PatchGrid,
    frame_shape: tuple[int, int],
    size: tuple[int, int],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Interpolate levels and confidence from the patch grid.

    Every output pixel takes the level of the patch with the most weight (bilinear weight times
    confidence) among the four around it, averaged with those of the four that lie on the same
    surface. Beyond the outermost patch centres the nearest patch goes on.

    Parameters
    ----------
    level, confidence : ndarray, float32 [grid rows, grid columns]
        Levels may be NaN where the confidence is 0.
    grid : PatchGrid
    frame_shape : (int, int)
        Rows and columns of the frame that the grid covers.
    size : (int, int)
        Rows and columns of the output, which covers the whole frame.

    Returns
    -------
    level, confidence : ndarray, float32 of shape `size`
    """
    rows, row_weights = _neighbours(grid.row_centres, frame_shape[0], size[0])
    columns, column_weights = _neighbours(grid.column_centres, frame_shape[1], size[1])
    known = np.nan_to_num(level)

    def corners(patches: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.array([patches.take(i, 0).take(j, 1) for i in rows for j in columns])

    bilinear = np.array([i[:, None] * j for i in row_weights for j in column_weights])
    trusted = bilinear * corners(confidence)
    upsampled_confidence = trusted.sum(axis=0)
    trusted += np.float32(1e-6) * bilinear  # so that there is a patch with the most trust
    values = corners(known)
    chosen = np.take_along_axis(values, trusted.argmax(axis=0)[None], axis=0)
    trusted *= np.abs(values - chosen) <= _SAME_SURFACE
    upsampled = (trusted * values).sum(axis=0) / trusted.sum(axis=0)
    upsampled[upsampled_confidence <= 0] = np.nan
    return upsampled, upsampled_confidence


def _neighbours(
    centres: NDArray[np.intp], frame_length: int, length: int
) -> tuple[tuple[NDArray[np.intp], ...], tuple[NDArray[np.float32], ...]]:
    """Give indices and linear weights of the two patches around every output pixel of an axis."""
    scale = frame_length / length
    positions = (np.arange(length) + 0.5) * scale - 0.5
    fractional = np.interp(positions, centres, np.arange(len(centres)))
    lower = np.minimum(fractional.astype(np.intp), max(len(centres) - 2, 0))
    upper = np.minimum(lower + 1, len(centres) - 1)
    above = (fractional - lower).astype(np.float32)
    return (lower, upper), (1 - above, above)
