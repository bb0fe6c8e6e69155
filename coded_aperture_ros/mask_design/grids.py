"""Grids of open and closed cells: what can be made of them, and how to draw and change them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.optics import Mask

SYMMETRIES = ("none", "point", "mirror")
CARRIERS = ("transparent", "connected")


def smallest_openings(grids: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return the side of the largest square that every open cell of a mask has a place in.

    Parameters
    ----------
    grids : ndarray [B, n, n]

    Returns
    -------
    ndarray of int [B]
        Cells; 0 for a mask without an open cell.
    """
    opened = np.asarray(grids) > 0
    widths = np.zeros(len(opened), np.int64)
    unchanged = opened.any(axis=(1, 2))
    side = 0
    while unchanged.any():
        widths[unchanged] = side
        side += 1
        if side > opened.shape[-1]:
            break
        unchanged = unchanged & (squares_only(opened, side) == opened).all(axis=(1, 2))
    else:
        return widths
    widths[unchanged] = side - 1
    return widths


def squares_only(opened: NDArray[np.bool_], side: int) -> NDArray[np.bool_]:
    """Keep of each mask [B, n, n] the cells that lie in open squares of a side (an opening)."""
    n = opened.shape[-1]
    count = n - side + 1
    fits = np.ones((len(opened), count, count), bool)
    for row in range(side):
        for column in range(side):
            fits &= opened[:, row : row + count, column : column + count]
    kept = np.zeros_like(opened)
    for row in range(side):
        for column in range(side):
            kept[:, row : row + count, column : column + count] |= fits
    return kept


def is_connected(grid: NDArray[np.bool_]) -> bool:
    """Whether all that is closed hangs together with the frame around the mask [n, n]."""
    closed = np.pad(~grid, 1, constant_values=True).astype(np.uint8)
    count, _ = cv2.connectedComponents(closed, connectivity=4)
    return bool(count == 2)


def symmetric(grids: NDArray[np.bool_], symmetry: str) -> NDArray[np.bool_]:
    """Make masks [B, n, n] the same after a half turn (`point`), or in a mirror (`mirror`)."""
    if symmetry == "point":
        return grids | grids[:, ::-1, ::-1]
    if symmetry == "mirror":
        return grids | grids[:, :, ::-1]
    return grids


def random_grids(
    count: int,
    cells: int,
    opening: int,
    symmetry: str,
    random: np.random.Generator,
    light: tuple[float, float] = (0.1, 0.8),
) -> NDArray[np.bool_]:
    """Draw masks of open squares, with open shares from a range [count, cells, cells]."""
    grids = np.zeros((count, cells, cells), bool)
    for grid in grids:
        target = random.uniform(*light)
        while grid.mean() < target:
            row, column = random.integers(0, cells - opening + 1, 2)
            grid[row : row + opening, column : column + opening] = True
            grid[:] = symmetric(grid[None], symmetry)[0]
    return grids


def random_masks(count: int, seed: int) -> list[Mask]:
    """Draw masks of 7 to 13 cells, with openings of 1 to 3 cells, with and without symmetry.

    Those of one seed begin with those of a smaller count.
    """
    random = np.random.default_rng(seed)
    masks = []
    for number in range(count):
        cells, opening = int(random.integers(7, 14)), int(random.integers(1, 4))
        symmetry = SYMMETRIES[random.integers(0, 2)]
        (grid,) = random_grids(1, cells, opening, symmetry, random)
        masks.append(Mask(f"random_{number}", grid.astype(np.float32)))
    return masks


def changed(
    grids: NDArray[np.bool_], opening: int, symmetry: str, random: np.random.Generator
) -> NDArray[np.bool_]:
    """Return a child of every mask [B, n, n]: a mutation, or a mixture with another one.

    A child may break constraints; see `allowed`.
    """
    children = grids.copy()
    n = grids.shape[-1]
    moves = random.integers(0, 6, len(grids))
    for child, move in zip(children, moves, strict=True):
        row, column = random.integers(0, n - opening + 1, 2)
        square = child[row : row + opening, column : column + opening]
        if move <= 1:  # open or close a square
            square[:] = not square.all()
        elif move == 2:  # move a square
            to_row, to_column = random.integers(0, n - opening + 1, 2)
            taken = square.copy()
            square[:] = False
            child[to_row : to_row + opening, to_column : to_column + opening] |= taken
        elif move == 3:  # shift all
            child[:] = np.roll(child, tuple(random.integers(-1, 2, 2)), axis=(0, 1))
        elif move == 4:  # a part of another mask
            other = grids[random.integers(len(grids))]
            first, last = np.sort(random.integers(0, n + 1, 2))
            child[first:last] = other[first:last]
        else:  # several cells at once
            flips = random.random(child.shape) < 2 / n**2
            child[:] = child ^ flips
    if opening > 1:
        children = squares_only(children, opening)
    if symmetry == "none":
        return children
    # The upper half, or the left, is what the other follows.
    half = np.zeros_like(children)
    if symmetry == "point":
        half[:, : (n + 1) // 2] = children[:, : (n + 1) // 2]
    else:
        half[:, :, : (n + 1) // 2] = children[:, :, : (n + 1) // 2]
    return symmetric(half, symmetry)


def allowed(
    grids: NDArray[np.bool_],
    opening: int,
    light: tuple[float, float],
    carrier: str,
) -> NDArray[np.bool_]:
    """Which masks keep to the constraints [B].

    Parameters
    ----------
    grids : ndarray of bool [B, n, n]
    opening : int
        Every open cell lies in an open square of this side.
    light : (float, float)
        Least and most open share.
    carrier : str
        `transparent`: any pattern can be printed; `connected`: what is closed must hang together
        with the frame, or it falls out.
    """
    share = grids.mean(axis=(1, 2))
    fits = (share >= light[0]) & (share <= light[1]) & (share > 0) & (share < 1)
    # The mask's size is that of its grid: it has to be filled.
    fits &= grids[:, 0].any(1) & grids[:, -1].any(1)
    fits &= grids[:, :, 0].any(1) & grids[:, :, -1].any(1)
    if opening > 1:
        fits &= (squares_only(grids, opening) == grids).all(axis=(1, 2))
    if carrier == "connected":
        fits[fits] = [is_connected(grid) for grid in grids[fits]]
    return fits
