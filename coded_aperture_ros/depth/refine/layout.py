"""Between cells, squares of 2 x 2 cells, and the four half-cells of each cell."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.compiled import Compiled


def in_squares(values: FloatArray) -> FloatArray:
    """Put the cells of 2 x 2 into channels: [n, b, rows, columns] to [b, 4 n, squares]."""
    count, sizes, rows, columns = values.shape
    squares = np.empty((sizes, count, 4, rows // 2, columns // 2), np.float32)
    _put_in_squares(values, squares)
    return squares.reshape(sizes, 4 * count, -1)


def _put_loop(values: FloatArray, squares: FloatArray) -> None:
    sizes, count, _, rows, columns = squares.shape
    for b in range(sizes):
        for n in range(count):
            for i in range(rows):
                for quarter in range(4):
                    down, right = quarter // 2, quarter % 2
                    for j in range(columns):
                        squares[b, n, quarter, i, j] = values[n, b, 2 * i + down, 2 * j + right]


def _put_plain(values: FloatArray, squares: FloatArray) -> None:
    for quarter in range(4):
        cells = values[..., quarter // 2 :: 2, quarter % 2 :: 2]
        squares[:, :, quarter] = cells.swapaxes(0, 1)


_put_in_squares = Compiled(_put_loop, _put_plain)


def at_half_cells(of_cells: NDArray[Any]) -> NDArray[Any]:
    """Put groups of four channels side by side: [4 n, rows, columns] to [n, 2 rows, 2 columns]."""
    count, rows, columns = of_cells.shape
    whole = np.empty((count // 4, 2 * rows, 2 * columns), of_cells.dtype)
    for quarter in range(4):
        whole[:, quarter // 2 :: 2, quarter % 2 :: 2] = of_cells[quarter::4]
    return whole


def _subtract_loop(costs: FloatArray, size: FloatArray) -> None:
    count, rows, columns = costs.shape
    far, near = np.float32(0.25), np.float32(0.75)
    for b in range(count):
        for i in range(2 * rows):
            here = i // 2
            beside = min(max(here + 2 * (i % 2) - 1, 0), rows - 1)
            for j in range(columns):
                left, right = max(j - 1, 0), min(j + 1, columns - 1)
                middle = near * costs[b, here, j] + far * costs[b, beside, j]
                before = near * costs[b, here, left] + far * costs[b, beside, left]
                after = near * costs[b, here, right] + far * costs[b, beside, right]
                size[b, i, 2 * j] -= near * middle + far * before
                size[b, i, 2 * j + 1] -= near * middle + far * after


def _subtract_plain(costs: FloatArray, size: FloatArray) -> None:
    for of_size, cost in zip(size, costs, strict=True):
        of_size -= cv2.resize(cost, of_size.shape[::-1], interpolation=cv2.INTER_LINEAR)


# Subtracts costs of cells [n, rows, columns], linear between their middles, from what there is of
# half-cells [n, 2 rows, 2 columns].
subtract_enlarged = Compiled(_subtract_loop, _subtract_plain)
