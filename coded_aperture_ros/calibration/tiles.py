"""Small pictures side by side in one, for people to look at."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_GAP_PX = 6


def tiled(
    tiles: Sequence[NDArray[np.floating]], per_row: int, gap_light: float
) -> NDArray[np.float32]:
    """Return square tiles of one size [k, k] in rows, with gaps between and around them."""
    side = len(tiles[0])
    step = side + _GAP_PX
    columns = min(per_row, len(tiles))
    shape = -(-len(tiles) // columns) * step + _GAP_PX, columns * step + _GAP_PX
    drawn = np.full(shape, gap_light, np.float32)
    for number, tile in enumerate(tiles):
        top, left = (_GAP_PX + step * place for place in divmod(number, columns))
        drawn[top : top + side, left : left + side] = tile
    return drawn


def enlarged(cells: NDArray[np.floating], side_px: int) -> NDArray[np.float32]:
    """Draw cells as whole squares of equal size, at most `side_px` wide in all if they fit."""
    factor = max(1, side_px // max(cells.shape))
    return np.kron(cells, np.ones((factor, factor), np.float32)).astype(np.float32)
