"""Between cells, squares of 2 x 2 cells, and the four half-cells of each cell."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.core.compiled import Compiled


def _put_loop(cells: FloatArray, channels: IndexArray, squares: FloatArray) -> None:
    count, _, rows, columns = squares.shape
    for n in range(count):
        channel = channels[n]
        for i in range(rows):
            for down in range(2):
                for j in range(columns):  # both at once: they lie side by side
                    squares[n, 2 * down, i, j] = cells[channel, 2 * i + down, 2 * j]
                    squares[n, 2 * down + 1, i, j] = cells[channel, 2 * i + down, 2 * j + 1]


def _put_plain(cells: FloatArray, channels: IndexArray, squares: FloatArray) -> None:
    for quarter in range(4):
        squares[:, quarter] = cells[channels, quarter // 2 :: 2, quarter % 2 :: 2]


# Puts some channels [n] of cells [channels, rows, columns], those of 2 x 2 cells side by side, into
# squares [n, 4, rows / 2, columns / 2].
put_in_squares = Compiled(_put_loop, _put_plain)


def at_half_cells(of_cells: NDArray[Any]) -> NDArray[Any]:
    """Put groups of four channels side by side: [4 n, rows, columns] to [n, 2 rows, 2 columns]."""
    count, rows, columns = of_cells.shape
    whole = np.empty((count // 4, 2 * rows, 2 * columns), of_cells.dtype)
    for quarter in range(4):
        whole[:, quarter // 2 :: 2, quarter % 2 :: 2] = of_cells[quarter::4]
    return whole


def _add_up_loop(
    cells: FloatArray, squares: FloatArray, costs: FloatArray, first: int, size: FloatArray
) -> None:
    count, rows, columns = costs.shape
    line, far, near = np.empty(columns + 2, np.float32), np.float32(0.25), np.float32(0.75)
    for b in range(count):
        for y in range(2 * first, 2 * (first + cells.shape[1])):
            i, down = y // 2, y % 2
            beside = min(max(i + 2 * down - 1, 0), rows - 1)
            for j in range(columns):
                line[1 + j] = near * costs[b, i, j] + far * costs[b, beside, j]
            line[0], line[columns + 1] = line[1], line[columns]
            left, right = cells[4 * b + 2 * down, i - first], cells[4 * b + 2 * down + 1, i - first]
            of_left, of_right, s = 8 * down + 2 * (i % 2), 8 * down + 2 * (i % 2) + 4, i // 2
            for c in range(columns // 2):
                j, x = 2 * c, 4 * c
                before, here, then, after = line[j], line[j + 1], line[j + 2], line[j + 3]
                less, more = near * here + far * before, near * here + far * then
                size[b, y, x] = left[j] + squares[b, of_left, s, c] - less
                size[b, y, x + 1] = right[j] + squares[b, of_right, s, c] - more
                less, more = near * then + far * here, near * then + far * after
                size[b, y, x + 2] = left[j + 1] + squares[b, of_left + 1, s, c] - less
                size[b, y, x + 3] = right[j + 1] + squares[b, of_right + 1, s, c] - more


def _add_up_plain(
    cells: FloatArray, squares: FloatArray, costs: FloatArray, first: int, size: FloatArray
) -> None:
    end = first + cells.shape[1]
    around = np.clip(np.arange(first - 1, end + 1), 0, costs.shape[1] - 1)
    for b, cost in enumerate(costs):
        of_cells = cells[4 * b : 4 * b + 4] + at_half_cells(squares[b, :16, first // 2 : end // 2])
        less = cv2.resize(cost[around], None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)
        size[b, 2 * first : 2 * end] = at_half_cells(of_cells)[0] - less[2:-2]


# Writes logits of the half-cells [>= n, 2 rows, 2 columns] of some rows of cells, from an even one
# on: what there is of them [>= 4 n, some rows, columns] and of all squares [n, >= 16, rows / 2,
# columns / 2], less the costs of all cells [n, rows, columns], linear between their middles.
add_up = Compiled(_add_up_loop, _add_up_plain)
