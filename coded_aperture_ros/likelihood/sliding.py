"""Products of the transforms of all windows.

Horizontally, the right half of every window is added to its left half, and subtracted from it: the
window and the cosines are symmetric, the sines antisymmetric, so a transform is two matrix products
of half the size. Windows of a frame of 640x480 took one thread 2.0 ms, and take 1.2 ms.

Vertically, windows share most of their rows. Without the Hann window ``w``, and with phases
counted from the top of the frame, the sum over the rows of a window slides down the frame: rows
that enter at the bottom have the same factor as those that leave at the top, ``n`` rows above::

    R(v) = sum_y z_y e^(-i v y)        R(v) += sum_y (z_y - z_(y - n)) e^(-i v y), y: new rows

The Hann window joins three neighbouring frequencies, ``t`` being the phase of one cycle per window
at the first row::

    w_m = a + 2 b cos(2 pi m / n)      Z(v) = a R(v) + b (R(v - 1) / t + R(v + 1) t)

For patches of 48 px every 8 px that takes 2.5 ms; matrix products over all rows of every window,
and the products of their results, took 10.7 ms.
"""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.likelihood.plan import Plan
from coded_aperture_ros.likelihood.sliding_plain import Buffers, Window, fold_plain, slide_plain

# Rows are filled up to a multiple of this: the rest of a loop that a processor's vectors do not
# divide takes as long as many of them.
_LANES = 16
# Pixel rows that are added at a time: few passes over the sums.
_AT_ONCE = 4

# Alignment of buffers, bytes: vectors that cross lines of the cache took 3.3 in place of 2.5 ms.
_LINE = 64


class SlidingTransform:
    """Transforms of all windows of frames of one size, and their products; see `Plan`.

    Parameters
    ----------
    plan : Plan
    threads : int
        Threads that call it at the same time.

    Attributes
    ----------
    products : ndarray, float32 [F, rows, columns]
        Of every window; those without a weight in `Plan.features` are left out.
    """

    def __init__(self, plan: Plan, threads: int = 1) -> None:
        grid, n = plan.grid, plan.grid.window_px
        lanes = -(-grid.columns // _LANES) * _LANES
        shape = len(plan.horizontal) // 2, 2, n + plan.pixel_rows, lanes
        # Transform of every pixel row at every column of windows, after `n` rows of zeros.
        self._horizontal = _aligned_zeros(*shape)
        new = -(-np.gcd(n, grid.stride_px) // _AT_ONCE) * _AT_ONCE
        sizes = (new, 2 * lanes), (n // 2 + 3, 2, 2 * lanes), (2, lanes)
        self._buffers = [tuple(_aligned_zeros(*size) for size in sizes) for _ in range(threads)]
        # The middle of a window is its own mirror image; its first pixel has no weight.
        waves = plan.horizontal.reshape(2, -1, n)[:, :, 1 : n // 2 + 1].copy()
        waves[:, :, -1] /= 2
        self._half_waves = waves
        self.products = np.empty(
            (int(plan.horizontal_counts.sum()), grid.rows, grid.columns), np.float32
        )
        angle = 2 * np.pi / n * np.outer(np.arange(n // 2 + 1), np.arange(n + _AT_ONCE - 1))
        self._waves = np.stack([np.cos(angle), np.sin(angle)]).astype(np.float32)
        window = plan.vertical[2 * plan.paired]  # without cycles it is the window itself
        self._window = window, self._waves[0, 1, :n] @ window / n, window.mean()
        self._index = _product_index(plan)
        self._stride_px = grid.stride_px

    @property
    def frequencies(self) -> range:
        """The H horizontal frequencies; the first have the most products."""
        return range(len(self._index))

    def new_buffer(self, rows: int) -> FloatArray:
        """Buffer of a thread for `transform_rows`."""
        return np.zeros((*self._half_waves.shape[::2], rows, self._horizontal.shape[3]), np.float32)

    def transform_rows(self, pixels: FloatArray, first: int, buffer: FloatArray) -> None:
        """Transform some pixel rows horizontally, from the first on that patches cover.

        `pixels` are those of the patches; `buffer` is of a thread, for at least as many rows.
        """
        rows, columns = len(pixels), self.products.shape[2]
        fold(pixels, self._stride_px, columns, buffer)
        start = len(self._window[0]) + first
        out = self._horizontal[:, :, start : start + rows].reshape(*self._horizontal.shape[:2], -1)
        for wave, halves in enumerate(buffer[:, :, :rows]):
            np.matmul(self._half_waves[wave], halves.reshape(len(halves), -1), out=out[:, wave])

    def slide_down(self, frequency: int, thread: int = 0) -> None:
        """Write the products of one of the `frequencies`."""
        slide(
            self._horizontal[frequency],
            self._waves,
            self._window,
            self._stride_px,
            self._index[frequency],
            self._buffers[thread],
            self.products,
        )


def _aligned_zeros(*shape: int) -> FloatArray:
    """Zeros that begin where a line of the cache does; float32."""
    count = int(np.prod(shape))
    room = np.zeros(count + _LINE // 4, np.float32)
    first = -room.ctypes.data // 4 % (_LINE // 4)
    return room[first : first + count].reshape(shape)


def _product_index(plan: Plan) -> list[IndexArray]:
    """Of every horizontal frequency, where the products go [2, vertical]; -1: nowhere.

    First those of ``q``, or of the power, then those of ``x``, up to the last frequency with any.
    """
    paired, half = plan.paired, plan.grid.window_px // 2
    first = np.cumsum(plan.horizontal_counts) - plan.horizontal_counts
    horizontal = np.arange(len(plan.horizontal) // 2)[:, None]
    index = np.where(horizontal < plan.horizontal_counts, first + horizontal, -1)
    placed = np.full((len(horizontal), 2, half + 1), -1, np.intp)
    placed[:, 0, 1 : paired + 1] = index[:, :paired]
    placed[:, 1, 1 : paired + 1] = index[:, paired : 2 * paired]
    unpaired = [0, half][: len(plan.vertical) - 2 * paired]
    placed[:, 0, unpaired] = index[:, 2 * paired :]
    counts = [int(np.flatnonzero(of.max(axis=0) >= 0).max(initial=-1)) + 1 for of in placed]
    return [np.ascontiguousarray(of[:, :count]) for of, count in zip(placed, counts, strict=True)]


def _fold_loop(pixels: FloatArray, stride: int, columns: int, folded: FloatArray) -> None:
    half, lanes = folded.shape[1], folded.shape[3]
    # Pixels of a row by their place in a stride: those of all windows are then side by side.
    places = np.zeros((stride, lanes + 2 * half // stride + 1), np.float32)
    for y in range(len(pixels)):
        for j in range(stride):
            some = pixels[y, j:]
            for x in range((len(some) + stride - 1) // stride):
                places[j, x] = some[x * stride]
        for k in range(1, half + 1):
            mirrored = 2 * half - k
            left = places[k % stride, k // stride :]
            right = places[mirrored % stride, mirrored // stride :]
            for x in range(columns):
                folded[0, k - 1, y, x] = left[x] + right[x]
                folded[1, k - 1, y, x] = left[x] - right[x]


# Sums and differences of the left and right half of the windows of some pixel rows [rows, width],
# whose distance and number are given [2, n / 2, >= rows, >= columns].
fold = Compiled(_fold_loop, fold_plain)


def _slide_loop(
    rows: FloatArray,
    waves: FloatArray,
    window: Window,
    stride: int,
    index: IndexArray,
    buffers: Buffers,
    products: FloatArray,
) -> None:
    n, swing, mean = len(window[0]), window[1], window[2]
    cosine, sine = waves[0], waves[1]
    (_, height, lanes), columns = rows.shape, products.shape[2]
    block, last = np.gcd(n, stride), min(index.shape[1], n // 2)
    # Both horizontal parts at once are faster.
    new, sums, found = buffers
    parted, parts = new.reshape(len(new), 2, lanes), sums.reshape(len(sums), 2, 2, lanes)
    sums[: last + 3] = 0
    for top in range(0, height - n - block + 1, block):
        for at in range(2 * block):
            j, part = at // 2, at % 2
            for x in range(lanes):
                parted[j, part, x] = rows[part, n + top + j, x] - rows[part, top + j, x]
        for v in range(last + 1):
            for j in range(0, block, _AT_ONCE):
                k = top % n + j
                c0, c1, c2, c3 = cosine[v, k], cosine[v, k + 1], cosine[v, k + 2], cosine[v, k + 3]
                s0, s1, s2, s3 = sine[v, k], sine[v, k + 1], sine[v, k + 2], sine[v, k + 3]
                for x in range(2 * lanes):
                    r0, r1, r2, r3 = new[j, x], new[j + 1, x], new[j + 2, x], new[j + 3, x]
                    sums[v + 1, 0, x] += c0 * r0 + c1 * r1 + c2 * r2 + c3 * r3
                    sums[v + 1, 1, x] += s0 * r0 + s1 * r1 + s2 * r2 + s3 * r3
        start = top + block - n
        if start < 0 or start % stride:
            continue
        for x in range(2 * lanes):  # beyond both ends frequencies are those within, mirrored
            sums[0, 0, x], sums[0, 1, x] = sums[2, 0, x], -sums[2, 1, x]
            sums[last + 2, 0, x], sums[last + 2, 1, x] = sums[last, 0, x], -sums[last, 1, x]
        row, turn = start // stride, start % n
        c, s = swing * cosine[1, turn], swing * sine[1, turn]
        for v in range(index.shape[1]):
            for x in range(lanes):
                c0, c1, c2 = parts[v, 0, 0, x], parts[v + 1, 0, 0, x], parts[v + 2, 0, 0, x]
                s0, s1, s2 = parts[v, 1, 0, x], parts[v + 1, 1, 0, x], parts[v + 2, 1, 0, x]
                cc = mean * c1 + c * (c0 + c2) + s * (s2 - s0)
                sc = mean * s1 + c * (s0 + s2) + s * (c0 - c2)
                c0, c1, c2 = parts[v, 0, 1, x], parts[v + 1, 0, 1, x], parts[v + 2, 0, 1, x]
                s0, s1, s2 = parts[v, 1, 1, x], parts[v + 1, 1, 1, x], parts[v + 2, 1, 1, x]
                cs = mean * c1 + c * (c0 + c2) + s * (s2 - s0)
                ss = mean * s1 + c * (s0 + s2) + s * (c0 - c2)
                found[0, x] = cc * cc + cs * cs + sc * sc + ss * ss
                found[1, x] = cc * ss - cs * sc
            for kind in range(2):
                place = index[kind, v]
                if place >= 0:
                    for x in range(columns):
                        products[place, row, x] = found[kind, x]


# Writes the products of one horizontal frequency from `rows` [2, n + pixel rows, lanes], waves of
# all vertical frequencies [2, >= V, >= n], the window, the distance of windows, and the places of
# the products [2, V], with buffers; see `SlidingTransform`.
slide = Compiled(_slide_loop, slide_plain)
