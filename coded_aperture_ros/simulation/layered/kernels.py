"""The loops over rows, lens samples, layers and pixels; needs numba.

A ray from pixel ``(y, x)`` through the lens at ``(v, u)`` arrives at ``p = (y, x) - (v, u) S(p)``.
On a plane the blur size ``S`` is linear, so ``p`` is linear in ``x`` along a row of pixels: every
layer is passed by one loop without branches.
"""

import math

import numpy as np
from numba import njit

_FINENESS = np.float32(2.0)
_OPAQUE = np.float32(1e-3)
_STEPS = 3


@njit(cache=True, fastmath=True, inline="always")
def _within(first, step, low, high, start, stop):  # type: ignore[no-untyped-def]
    """Integers of a range at which ``first + step x`` is in [low, high)."""
    if abs(step) < 1e-9:
        return (start, stop) if low <= first < high else (start, start)
    one, two = (low - first) / step, (high - first) / step
    if one > two:
        one, two = two, one
    return max(start, math.ceil(one + 1e-3)), min(stop, math.floor(two - 1e-3) + 1)


@njit(cache=True, fastmath=True)
def trace(table, sizes, light, cover, relief, samples, height, width):  # type: ignore[no-untyped-def]
    """See `traced`."""
    frame = np.zeros((height, width), np.float32)
    open_, found = np.empty(width, np.float32), np.empty(width, np.float32)
    one = np.float32(1)
    for y in range(height):
        for sample in range(len(samples)):
            v, u, weight = samples[sample]
            open_[:] = 1
            found[:] = 0
            for layer in range(len(table)):
                top, left, base, down, right = table[layer]
                offset, rows, columns, bumps = sizes[layer]
                scale = 1 / (1 + down * v + right * u)
                size, growth = (base + down * y) * scale, right * scale
                row, row_step = (y - v * size - top) * _FINENESS, -v * growth * _FINENESS
                column = (-u * size - left) * _FINENESS
                column_step = (1 - u * growth) * _FINENESS
                start, stop = _within(row, row_step, 0.0, rows - 1.0, 0, width)
                start, stop = _within(column, column_step, 0.0, columns - 1.0, start, stop)
                row, row_step = np.float32(row), np.float32(row_step)
                column, column_step = np.float32(column), np.float32(column_step)
                for x in range(start, stop):
                    if bumps < 0:
                        r = row + row_step * np.float32(x)
                        c = column + column_step * np.float32(x)
                    else:
                        r, c = _on_relief(
                            relief, bumps, rows, columns, y, x, v, u, top, left, size + growth * x
                        )
                    i, j = np.int32(r), np.int32(c)
                    b, d = r - np.float32(i), c - np.float32(j)
                    at = offset + i * columns + j
                    below = at + columns
                    w0, w1, w2, w3 = (one - b) * (one - d), (one - b) * d, b * (one - d), b * d
                    hides = w0 * cover[at] + w1 * cover[at + 1]
                    hides += w2 * cover[below] + w3 * cover[below + 1]
                    shines = w0 * light[at] + w1 * light[at + 1]
                    shines += w2 * light[below] + w3 * light[below + 1]
                    found[x] += open_[x] * shines
                    open_[x] *= one - hides
            for x in range(width):
                frame[y, x] += weight * found[x] / max(one - open_[x], _OPAQUE)
    return frame


@njit(cache=True, fastmath=True)
def _on_relief(relief, bumps, rows, columns, y, x, v, u, top, left, plane):  # type: ignore[no-untyped-def]
    """Return where a ray arrives on a curved surface; quick to converge, as the lens is small."""
    r, c = np.float32(0), np.float32(0)
    size = plane
    for _ in range(_STEPS):
        r = np.float32(min(max((y - v * size - top) * _FINENESS, 0.0), rows - 1.01))
        c = np.float32(min(max((x - u * size - left) * _FINENESS, 0.0), columns - 1.01))
        size = plane + relief[bumps + int(r + 0.5) * columns + int(c + 0.5)]
    return r, c


@njit(cache=True, fastmath=True)
def front(table, sizes, light, cover, relief, height, width):  # type: ignore[no-untyped-def]
    """See `seen_from_centre`."""
    blur = np.full((height, width), np.float32(math.nan))
    for y in range(height):
        for x in range(width):
            for layer in range(len(table)):
                top, left, base, down, right = table[layer]
                offset, rows, columns, bumps = sizes[layer]
                i = math.floor((y - top) * _FINENESS + 0.5)
                j = math.floor((x - left) * _FINENESS + 0.5)
                at = i * columns + j
                if 0 <= i < rows and 0 <= j < columns and cover[offset + at] > 0.49:
                    size = base + down * y + right * x
                    blur[y, x] = size if bumps < 0 else size + relief[bumps + at]
                    break
    return blur
