"""Forms of the loops of `sliding` for NumPy, where there is no numba."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray

# The window [n], its b and its a.
Window = tuple[FloatArray, np.float32, np.float32]
# Rows that enter less those that leave [some, 2 lanes], sums of -1 to n / 2 + 1 cycles by wave
# [n / 2 + 3, 2, 2 lanes], and products of one frequency [2, lanes].
Buffers = tuple[FloatArray, FloatArray, FloatArray]


def fold_plain(pixels: FloatArray, stride: int, columns: int, folded: FloatArray) -> None:
    """Form of `fold` for NumPy."""
    n = 2 * folded.shape[1]
    windows = np.lib.stride_tricks.sliding_window_view(pixels, n, axis=1)[:, ::stride]
    windows = np.moveaxis(windows, -1, 0)
    left, right = windows[1 : n // 2 + 1], windows[: n // 2 - 1 : -1]
    rows = slice(0, len(pixels))
    np.add(left, right, out=folded[0, :, rows, :columns])
    np.subtract(left, right, out=folded[1, :, rows, :columns])


def slide_plain(
    rows: FloatArray,
    waves: FloatArray,
    window: Window,
    stride: int,
    index: IndexArray,
    buffers: Buffers,
    products: FloatArray,
) -> None:
    """Form of `slide` for NumPy."""
    weights, height, columns = window[0], *products.shape[1:]
    n, count = len(weights), index.shape[1]
    windowed = (waves[:, :count, :n] * weights).reshape(2 * count, n)
    for row in range(height):
        first = n + row * stride
        cosines, sines = windowed @ rows[:, first : first + n, :columns]
        (cc, sc), (cs, ss) = cosines.reshape(2, count, -1), sines.reshape(2, count, -1)
        found = cc * cc + cs * cs + sc * sc + ss * ss, cc * ss - cs * sc
        for places, values in zip(index, found, strict=True):
            products[places[places >= 0], row] = values[places >= 0]
