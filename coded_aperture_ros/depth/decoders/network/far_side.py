"""Side of the focal plane of every half-cell, where levels are on both sides."""

from collections.abc import Callable

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth.decoders.network.cells import HALF_CELL_PX, Cells
from coded_aperture_ros.depth.decoders.sides import FocalSides


def far_probability(
    sides: FocalSides,
    level_of: Callable[[FloatArray], FloatArray],
    size_px: FloatArray,
    volume: FloatArray,
    cells: Cells,
) -> FloatArray:
    """Probability of every half-cell to lie beyond the focal plane [rows, columns].

    Parameters
    ----------
    sides : FocalSides
    level_of : callable
        Fractional level of signed blur sizes.
    size_px : ndarray, float32 [rows, columns]
        Blur size of every half-cell, without sign.
    volume : ndarray, float32 [grid rows, grid columns, L]
        Cost of every level.
    cells : Cells
    """
    grid = cells.grid
    rows, columns = (
        (centres - first) // HALF_CELL_PX
        for centres, first in ((grid.row_centres, cells.top), (grid.column_centres, cells.left))
    )
    # A centre is where four half-cells meet.
    means = cv2.blur(size_px, (2, 2), anchor=(1, 1), borderType=cv2.BORDER_REPLICATE)
    beyond = level_of(means[np.ix_(rows, columns)])
    probability = sides.confidence(beyond, volume, grid)
    nearest = (
        np.abs(
            HALF_CELL_PX * np.arange(length)[:, None] + first + HALF_CELL_PX // 2 - centres
        ).argmin(1)
        for length, first, centres in (
            (size_px.shape[0], cells.top, grid.row_centres),
            (size_px.shape[1], cells.left, grid.column_centres),
        )
    )
    return probability[np.ix_(*nearest)]
