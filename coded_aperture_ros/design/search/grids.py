"""Grids of open and closed cells: constraints, random grids and mutations."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray
from coded_aperture_ros.design.scores.predict import squares_only

SYMMETRIES = ("none", "point", "mirror")
CARRIERS = ("transparent", "connected")


def is_connected(grid: BoolArray) -> bool:
    """Whether all closed cells are connected with the frame around the mask [n, n]."""
    closed = np.pad(~grid, 1, constant_values=True).astype(np.uint8)
    count, _ = cv2.connectedComponents(closed, connectivity=4)
    return bool(count == 2)


def symmetric(grids: BoolArray, symmetry: str) -> BoolArray:
    """Masks [B, n, n] made symmetric to a half turn (`point`), or to a mirror (`mirror`)."""
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
) -> BoolArray:
    """Random masks of open squares, with open shares from a range [count, cells, cells]."""
    grids = np.zeros((count, cells, cells), bool)
    for grid in grids:
        target = random.uniform(*light)
        while grid.mean() < target:
            row, column = random.integers(0, cells - opening + 1, 2)
            grid[row : row + opening, column : column + opening] = True
            grid[:] = symmetric(grid[None], symmetry)[0]
    return grids


def changed(
    grids: BoolArray, opening: int, symmetry: str, random: np.random.Generator
) -> BoolArray:
    """Child of every mask [B, n, n]: a mutation, or a mixture with another one.

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
    # The upper half, or the left, is what the other follows.
    if symmetry == "point":
        children[:, (n + 1) // 2 :] = False
    elif symmetry == "mirror":
        children[:, :, (n + 1) // 2 :] = False
    return symmetric(children, symmetry)


def allowed(grids: BoolArray, opening: int, light: tuple[float, float], carrier: str) -> BoolArray:
    """Which masks [B, n, n] satisfy the constraints [B].

    Every open cell has to lie in an open square of the side `opening`; `light` is the least and the
    most open share; with the carrier `transparent` any pattern can be printed, with `connected`
    closed cells must be connected with the frame, or they fall out.
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
