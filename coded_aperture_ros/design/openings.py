"""Openings of a mask: sizes, and outlines to cut."""

import dataclasses
import functools
from typing import Any

import cv2
import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Mask

# Widths are exact to this part of a cell; for openings made of square cells, exact.
_POINTS_PER_CELL = 4
# Cells a side of masks whose openings are made wider or narrower; four times as many for less.
_RECUT_CELLS = 1000
_LARGE_CHANGE = 0.005
Point = tuple[float, float]
Outline = list[Point]
# Curved masks are stored as coverage of cells; their outline is drawn in steps of this part of a
# cell, for the named masks 1/768 of the extent.
_STEPS_PER_CELL = 8
# How far the area of the outlines may be from the light that the mask lets through, as a share.
_MAX_AREA_ERROR = 0.02


@dataclasses.dataclass(frozen=True)
class Opening:
    """Opening of a mask; lengths are shares of the mask's extent."""

    width: float  # diameter of the largest disc within it
    x: float  # of its middle, to the right of the mask's
    y: float  # and below it


@dataclasses.dataclass(frozen=True)
class Openings:
    """Openings of a mask."""

    count: int  # cells that touch at a corner only are two
    # Diameter of the largest disc within the narrowest opening, as a share of the mask's extent:
    # `A / M` of the thesis.
    smallest_width: float
    each: tuple[Opening, ...]
    loose_parts: int  # closed, hang on nothing, and would fall out of a mask cut from cardboard


def open_cells(mask: Mask) -> BoolArray:
    """Cells [n, m] that let through more than half of the light of the most open one."""
    return np.asarray(mask.transmission > 0.5 * mask.transmission.max())


@functools.lru_cache(maxsize=16)  # a search asks for the same mask hundreds of times
def mask_openings(mask: Mask) -> Openings:
    """Openings of a mask: number, sizes, positions and loose parts; see `open_cells`.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> found = mask_openings(Mask.from_rows(["110", "110", "001"]))
    >>> found.count, round(found.smallest_width, 3)
    (2, 0.333)
    """
    cells = open_cells(mask)
    framed = np.pad(cells, 1)  # the mask's rim is closed, and holds what touches it
    fine = np.kron(framed, np.ones((_POINTS_PER_CELL, _POINTS_PER_CELL), bool)).astype(np.uint8)
    # Corner points of the fine cells that touch open cells only, and how far each is from a
    # closed one. The nearest point of a closed cell is always such a corner point too.
    inside = fine[:-1, :-1] & fine[1:, :-1] & fine[:-1, 1:] & fine[1:, 1:]
    radius = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    count, labels, _, middles = cv2.connectedComponentsWithStats(fine, connectivity=4)
    widest = np.zeros(count)
    np.maximum.at(widest, labels[1:, 1:], radius)
    widths = 2 * widest / _POINTS_PER_CELL / max(cells.shape)
    middles = (middles + 0.5 - np.array(fine.shape[::-1]) / 2) / _POINTS_PER_CELL / max(cells.shape)
    each = [Opening(*map(float, one)) for one in np.column_stack([widths, middles])]
    closed_count, _ = cv2.connectedComponents((~framed).astype(np.uint8), connectivity=4)
    return Openings(
        count=count - 1,
        smallest_width=float(widths[1:].min()),
        each=tuple(each[1:]),
        loose_parts=closed_count - 2,  # less what OpenCV counts as background, and the rim
    )


def narrowest_bar(mask: Mask) -> float:
    """Smallest distance between two openings, as a share of the extent.

    Infinite with one opening. Openings that touch at a corner have no bar between them.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> narrowest_bar(Mask.from_rows(["1001", "0000", "0000", "0100"]))
    0.5
    """
    framed = np.pad(open_cells(mask), 1).astype(np.uint8)
    count, labels = cv2.connectedComponents(framed, connectivity=4)
    around = _around(labels)
    corners = around.max(axis=0)
    narrowest = np.inf
    for label in range(1, count):
        # Corner points of the cells: the nearest ones of two openings are among them.
        own = _around((labels == label).astype(np.uint8)).max(axis=0)
        away = cv2.distanceTransform(1 - own, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        nearest = scipy.ndimage.minimum(away, corners, np.arange(1, count))
        touching = np.unique(around[:, own.astype(bool)])
        nearest[touching[touching > 0] - 1] = np.inf
        narrowest = min(narrowest, nearest.min())
    return float(narrowest / max(mask.transmission.shape))


def _around(cells: NDArray[Any]) -> NDArray[Any]:
    """Values [4, n - 1, m - 1] of the four cells around each corner point within the grid."""
    return np.stack([cells[:-1, :-1], cells[1:, :-1], cells[:-1, 1:], cells[1:, 1:]])


def recut(mask: Mask, change: float) -> Mask:
    """Mask with all openings wider by `change`, or narrower if it is negative.

    `change` is a share of the extent, half of it at each side of an opening. Openings do not grow
    beyond the grid's edge. Raises `InputError` if an opening is gone, the change is too small to be
    drawn, or the mask has grey cells.
    """
    cells = cells_to_cut(mask)
    fineness = _RECUT_CELLS * (1 if abs(change) >= _LARGE_CHANGE else 4)
    steps = -(-fineness // max(cells.shape))
    fine = np.kron(cells, np.ones((steps, steps), bool))
    reach = abs(change) / 2 * max(fine.shape)
    if 0 < reach < 1:
        raise InputError(f"mask {mask.name}: {abs(change):.2g} of its extent is too little to draw")
    # Around the grid all is closed.
    inside = (np.pad(fine, 1) == (change < 0)).astype(np.uint8)
    # To the middles of the nearest cells of the other kind, whose edges are half a cell nearer.
    away = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1] - 0.5
    still_open = np.asarray((away > reach) == (change < 0))
    before, after = (
        cv2.connectedComponents(one.astype(np.uint8), connectivity=4)[0] - 1
        for one in (fine, still_open)
    )
    if change < 0 and after < before:
        raise InputError(
            f"mask {mask.name}: {before - after} of {before} openings are narrower than "
            f"{abs(change):.2g} of its extent"
        )
    return Mask(mask.name, still_open.astype(np.float32))


def mask_outlines(mask: Mask) -> list[Outline]:
    """Closed outlines of the openings of a mask, as corners `(x, y)`.

    x goes to the right and y down, in units of the mask's extent, with the centre of the grid at
    (0, 0). Openings that touch at a corner have outlines of their own; an outline within another is
    of a closed part within an opening. Raises `InputError` if the mask has grey cells, which cannot
    be cut.
    """
    cells = cells_to_cut(mask)
    rows, columns = cells.shape
    extent = max(cells.shape)
    return [
        [((x - columns / 2) / extent, (y - rows / 2) / extent) for x, y in corners]
        for corners in _trace(cells)
    ]


def cells_to_cut(mask: Mask) -> BoolArray:
    """Open cells; finer ones for masks with curved outlines."""
    if np.isin(mask.transmission, (0.0, 1.0)).all():
        return open_cells(mask)
    steps = _STEPS_PER_CELL
    light = cv2.resize(
        np.pad(mask.transmission, 1), None, fx=steps, fy=steps, interpolation=cv2.INTER_LINEAR
    )[steps:-steps, steps:-steps]
    cells = np.asarray(light > 0.5)
    if abs(cells.mean() - mask.transmission.mean()) > _MAX_AREA_ERROR * mask.transmission.mean():
        raise InputError(
            f"mask {mask.name}: it has grey cells, which cannot be cut; use a picture of black and "
            "white"
        )
    return cells


def _trace(cells: BoolArray) -> list[list[tuple[int, int]]]:
    """Corners (x, y) of the outlines of the open cells, each clockwise with y down."""
    closed = ~np.pad(cells, 1)
    # For each side of a cell with a closed neighbour there: where its edge starts, and its
    # direction, so that the edges of a lone cell run around it clockwise.
    sides = (
        (closed[:-2, 1:-1], (0, 0), (1, 0)),
        (closed[1:-1, 2:], (1, 0), (0, 1)),
        (closed[2:, 1:-1], (1, 1), (-1, 0)),
        (closed[1:-1, :-2], (0, 1), (0, -1)),
    )
    edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for beside, (dx, dy), direction in sides:
        for y, x in np.argwhere(cells & beside).tolist():
            edges.setdefault((x + dx, y + dy), []).append(direction)
    outlines = []
    while edges:
        here = next(iter(edges))
        direction = edges[here][0]
        points = []
        directions = []
        while here in edges:
            # Where two cells touch at a corner, the right turn stays at the same cell.
            right = (-direction[1], direction[0])
            choices = edges[here]
            direction = right if right in choices else choices[0]
            choices.remove(direction)
            if not choices:
                del edges[here]
            points.append(here)
            directions.append(direction)
            here = here[0] + direction[0], here[1] + direction[1]
        before = [directions[-1], *directions]
        turns = zip(points, before, directions, strict=False)
        outlines.append([point for point, one, other in turns if one != other])
    return outlines
