"""Openings of masks in cells: how large the squares are that a mask can be cut from."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coded_aperture_ros.core.arrays import BoolArray


def smallest_openings(grids: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return the side of the largest square that each open cell of a mask has a place in [B].

    In cells, of masks [B, n, n]; 0 for a mask without an open cell.
    """
    opened = np.asarray(grids) > 0
    widths = np.zeros(len(opened), np.int64)
    kept = opened.any(axis=(1, 2))
    for side in range(1, opened.shape[-1] + 1):
        kept &= (squares_only(opened, side) == opened).all(axis=(1, 2))
        if not kept.any():
            break
        widths[kept] = side
    return widths


def squares_only(opened: BoolArray, side: int) -> BoolArray:
    """Keep of each mask [B, n, n] the cells that lie in open squares of a side (an opening)."""
    return np.asarray(ndimage.binary_opening(opened, np.ones((1, side, side), bool)))
