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
    row, row_weight = _neighbours(grid.row_centres, frame_shape[0], size[0])
    column, column_weight = _neighbours(grid.column_centres, frame_shape[1], size[1])
    known = np.nan_to_num(level)
    corners = [
        (np.ix_(row[i], column[j]), row_weight[i][:, None] * column_weight[j])
        for i in (0, 1)
        for j in (0, 1)
    ]
    best = np.full(size, -1, np.float32)
    chosen = np.zeros(size, np.float32)
    upsampled_confidence = np.zeros(size, np.float32)
    for index, bilinear in corners:
        trust = bilinear * (confidence[index] + np.float32(1e-6))
        better = trust > best
        chosen[better] = known[index][better]
        best = np.maximum(best, trust)
        upsampled_confidence += bilinear * confidence[index]
    total = np.zeros(size, np.float32)
    weight = np.zeros(size, np.float32)
    for index, bilinear in corners:
        value = known[index]
        trust = bilinear * (confidence[index] + np.float32(1e-6))
        trust *= np.abs(value - chosen) <= _SAME_SURFACE
        total += trust * value
        weight += trust
    # The chosen patch itself always contributes, so the weight is positive.
    upsampled = total / weight
    return np.where(upsampled_confidence > 0, upsampled, np.float32(np.nan)), upsampled_confidence


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
