"""The loops over tiles, pixels, points of the lens and boards of a room; needs numba."""

import math

import numpy as np
from numba import njit, prange

TILE_PX = 32
_NEAREST_M = np.float32(0.05)
_FARTHEST_M = np.float32(1e9)


@njit(cache=True, fastmath=True)
def _texel(textures, sides, starts, first, level, row, column):  # type: ignore[no-untyped-def]
    """Return what a texture shows at a place, mirrored beyond its edges and interpolated."""
    side = sides[level]
    start = first + starts[level]
    i, j = math.floor(row), math.floor(column)
    b, d = row - i, column - j
    found = 0.0
    for y, of_row in ((i, 1 - b), (i + 1, b)):
        y %= 2 * side
        y = min(y, 2 * side - 1 - y)
        for x, of_column in ((j, 1 - d), (j + 1, d)):
            x %= 2 * side
            x = min(x, 2 * side - 1 - x)
            found += of_row * of_column * textures[start + y * side + x]
    return found


@njit(cache=True, fastmath=True, inline="always")
def _first_board(boards, near, count, lx, ly, dx, dy):  # type: ignore[no-untyped-def]
    """Return depth, place and number of the board that a ray meets first; -1: none.

    The ray leaves the lens at `lx`, `ly` and moves by `dx`, `dy` in a metre of depth; `near` has
    the numbers of the `count` boards that it may meet.
    """
    best, of_right, of_down, hit = _FARTHEST_M, 0.0, 0.0, -1
    for index in range(count):
        b = boards[near[index]]
        # The corner, the normal, and the edges over their squared lengths.
        towards = b[3] * dx + b[4] * dy + b[5]
        if abs(towards) < 1e-9:
            continue
        qx, qy = b[0] - lx, b[1] - ly
        z = (b[3] * qx + b[4] * qy + b[5] * b[2]) / towards
        if z < _NEAREST_M or z >= best:
            continue
        qx, qy, qz = z * dx - qx, z * dy - qy, z - b[2]
        r = b[6] * qx + b[7] * qy + b[8] * qz
        if r < 0 or r > 1:
            continue
        d = b[9] * qx + b[10] * qy + b[11] * qz
        if d < 0 or d > 1:
            continue
        best, of_right, of_down, hit = z, r, d, near[index]
    return best, of_right, of_down, hit


@njit(cache=True, fastmath=True, parallel=True)
def trace(  # type: ignore[no-untyped-def]
    boards, boxes, paint, textures, sides, starts, samples, moves, square_px, lens, height, width
):
    """See `Room.seen`."""
    focal_px, middle_x, middle_y, focus_m, extent_m = lens
    light = np.zeros((height, width), np.float32)
    depth = np.zeros((height, width), np.float32)
    down, across = -(-height // TILE_PX), -(-width // TILE_PX)
    for tile in prange(down * across):
        top, left = tile // across * TILE_PX, tile % across * TILE_PX
        bottom, right = min(top + TILE_PX, height), min(left + TILE_PX, width)
        near = np.empty(len(boards), np.int64)
        count = 0
        for board in range(len(boards)):
            y0, y1, x0, x1 = boxes[board]
            if y0 < bottom and y1 >= top and x0 < right and x1 >= left:
                near[count] = board
                count += 1
        for y in range(top, bottom):
            for x in range(left, right):
                row = min(y // square_px, len(moves) - 1)
                column = min(x // square_px, moves.shape[1] - 1)
                for sample in range(len(samples)):
                    v, u, weight = samples[sample]
                    down_px, right_px, passed = moves[row, column, sample]
                    if passed <= 0:
                        continue
                    weight *= passed
                    lx, ly = u * extent_m, v * extent_m
                    dx = (x - right_px - middle_x) / focal_px - lx / focus_m
                    dy = (y - down_px - middle_y) / focal_px - ly / focus_m
                    best, of_right, of_down, hit = _first_board(boards, near, count, lx, ly, dx, dy)
                    if hit < 0:
                        continue
                    first, tone, contrast, texels_right, texels_down, texel_m = paint[hit]
                    # The level of the texture whose texels are about as large as a pixel there.
                    coarse = best / (focal_px * texel_m)
                    level = 0
                    while coarse > 1.5 and level < len(sides) - 1:
                        coarse /= 2
                        level += 1
                    shrink = 0.5**level
                    value = _texel(
                        textures,
                        sides,
                        starts,
                        int(first),
                        level,
                        (of_down * texels_down + 0.5) * shrink - 0.5,
                        (of_right * texels_right + 0.5) * shrink - 0.5,
                    )
                    light[y, x] += weight * tone * math.exp(contrast * value)
                    depth[y, x] = best
    return light, depth
