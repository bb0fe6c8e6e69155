"""From the coarse grid of patches to a map of the wanted size, without mixing across edges."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank import PatchGrid

# Levels that differ by more lie on two sides of a depth edge and are not averaged.
_SAME_SURFACE = 1.5


def upsample(
    level: NDArray[np.float32],
    grid: PatchGrid,
    frame_shape: tuple[int, ...],
    size: tuple[int, int],
) -> NDArray[np.float32]:
    """Interpolate levels from the patch grid.

    Every output pixel takes the level of the nearest patch, averaged bilinearly with those of the
    four around it that lie on the same surface. Beyond the outermost patch centres the nearest
    patch goes on.

    Parameters
    ----------
    level : ndarray, float32 [grid rows, grid columns]
    grid : PatchGrid
    frame_shape : (int, int)
        Rows and columns of the frame that the grid covers.
    size : (int, int)
        Rows and columns of the output, which covers the whole frame.

    Returns
    -------
    ndarray, float32 of shape `size`
    """
    rows, row_weights = _neighbours(grid.row_centres, frame_shape[0], size[0])
    columns, column_weights = _neighbours(grid.column_centres, frame_shape[1], size[1])
    nearest_rows, nearest_columns = nearest_patches(grid, frame_shape, size)
    nearest = level[nearest_rows][:, nearest_columns]
    total = np.zeros(size, np.float32)
    weight = np.zeros(size, np.float32)
    distance, share = np.empty(size, np.float32), np.empty(size, np.float32)
    same = np.empty(size, np.bool_)
    for i, across in zip(rows, row_weights, strict=True):
        of_rows = level[i]
        for j, along in zip(columns, column_weights, strict=True):
            corner = of_rows[:, j]
            np.subtract(corner, nearest, out=distance)
            np.abs(distance, out=distance)
            np.less_equal(distance, np.float32(_SAME_SURFACE), out=same)
            np.multiply(across[:, None], along, out=share)
            np.multiply(share, same, out=share)
            weight += share
            np.multiply(share, corner, out=share)
            total += share
    total /= weight
    return total


def nearest_patches(
    grid: PatchGrid, frame_shape: tuple[int, ...], size: tuple[int, int]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the row and the column of the patch nearest to every output row and column."""
    axes = (
        (grid.row_centres, frame_shape[0], size[0]),
        (grid.column_centres, frame_shape[1], size[1]),
    )
    rows, columns = (np.rint(_positions(*axis)).astype(np.intp) for axis in axes)
    return rows, columns


def _positions(centres: NDArray[np.intp], frame_length: int, length: int) -> NDArray[np.float64]:
    """Give the fractional patch index of every output pixel of an axis."""
    scale = frame_length / length
    return np.interp((np.arange(length) + 0.5) * scale - 0.5, centres, np.arange(len(centres)))


def _neighbours(
    centres: NDArray[np.intp], frame_length: int, length: int
) -> tuple[tuple[NDArray[np.intp], ...], tuple[NDArray[np.float32], ...]]:
    """Give indices and linear weights of the two patches around every output pixel of an axis."""
    fractional = _positions(centres, frame_length, length)
    lower = np.minimum(fractional.astype(np.intp), max(len(centres) - 2, 0))
    upper = np.minimum(lower + 1, len(centres) - 1)
    above = (fractional - lower).astype(np.float32)
    return (lower, upper), (1 - above, above)
