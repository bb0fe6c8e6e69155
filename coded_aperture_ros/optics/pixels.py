"""How much of each cell the squares of pixels cover, along one axis."""

import numpy as np
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray


def cell_shares(pixels: int, cells: int, cell_px: float, offset_px: ArrayLike = 0.0) -> DoubleArray:
    """Share of each cell that each pixel covers, along one axis [..., pixels, cells].

    Cells are `cell_px` wide. `offset_px`, of any shape [...], is the shift of the middle of the
    cells from the middle of the pixels.
    """
    pixel_edges = np.arange(pixels + 1)[:, None] - pixels / 2.0
    cell_edges = (np.arange(cells + 1) - cells / 2.0) * cell_px
    cell_edges = cell_edges + np.asarray(offset_px)[..., None, None]
    covered = np.clip(pixel_edges, cell_edges[..., :-1], cell_edges[..., 1:])
    return np.asarray(np.diff(covered, axis=-2) / cell_px)
