"""Outlines of a mask's openings: the lines to cut along."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.openings import open_cells
from coded_aperture_ros.optics import Mask

Point = tuple[float, float]
# Curved masks are stored as coverage of cells; their outline is drawn in steps of this part of a
# cell, for the named masks 1/768 of the extent.
_STEPS_PER_CELL = 8
# How far the area of the outlines may be from the light that the mask lets through, as a share.
_LARGEST_LOSS = 0.02


def outlines_of(mask: Mask) -> list[list[Point]]:
    """Trace the openings of a mask.

    Parameters
    ----------
    mask : Mask

    Returns
    -------
    list of list of (float, float)
        Closed outlines as corners `(x, y)`, x to the right and y down, in units of the mask's
        extent, with the centre of the grid at (0, 0). Openings that touch at a corner have
        outlines of their own; an outline within another is of a closed part within an opening.

    Raises
    ------
    InputError
        If the mask has grey cells that are neither open nor closed, and cannot be cut.
    """
    cells = open_cells(mask)
    extent = max(cells.shape)
    if not np.isin(mask.transmission, (0.0, 1.0)).all():
        cells = _fine_cells(mask)
    outlines = _trace(cells)
    rows, columns = cells.shape
    fine_extent = extent * (rows / mask.transmission.shape[0])
    return [
        [((x - columns / 2) / fine_extent, (y - rows / 2) / fine_extent) for x, y in outline]
        for outline in outlines
    ]


def _fine_cells(mask: Mask) -> NDArray[np.bool_]:
    light = cv2.resize(
        np.pad(mask.transmission, 1),
        None,
        fx=_STEPS_PER_CELL,
        fy=_STEPS_PER_CELL,
        interpolation=cv2.INTER_LINEAR,
    )[_STEPS_PER_CELL:-_STEPS_PER_CELL, _STEPS_PER_CELL:-_STEPS_PER_CELL]
    cells = np.asarray(light > 0.5)
    if abs(cells.mean() - mask.transmission.mean()) > _LARGEST_LOSS * mask.transmission.mean():
        raise InputError(
            f"mask {mask.name}: it has grey cells, which cannot be cut; use a picture of black and "
            "white"
        )
    return cells


def _trace(cells: NDArray[np.bool_]) -> list[list[Point]]:
    """Return the outlines of the open cells, corners only, openings on the right-hand side."""
    framed = np.pad(cells, 1)
    inside = framed[1:-1, 1:-1]
    # For each side of a cell with a closed neighbour there: where its edge starts, and its
    # direction, so that the edges of a lone cell run around it clockwise (with y down).
    sides = (
        (~framed[:-2, 1:-1], (0, 0), (1, 0)),
        (~framed[1:-1, 2:], (1, 0), (0, 1)),
        (~framed[2:, 1:-1], (1, 1), (-1, 0)),
        (~framed[1:-1, :-2], (0, 1), (0, -1)),
    )
    edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for is_closed, (dx, dy), direction in sides:
        for y, x in np.argwhere(inside & is_closed).tolist():
            edges.setdefault((x + dx, y + dy), []).append(direction)
    outlines = []
    while edges:
        start = next(iter(edges))
        here, direction = start, edges[start][0]
        corners: list[Point] = []
        while here in edges:
            following = _right_turn_first(edges, here, direction)
            if following != direction or not corners:
                corners.append(here)
            direction = following
            here = here[0] + direction[0], here[1] + direction[1]
        if _is_straight(corners[-1], corners[0], corners[1]):
            del corners[0]
        outlines.append(corners)
    return outlines


def _right_turn_first(
    edges: dict[tuple[int, int], list[tuple[int, int]]],
    here: tuple[int, int],
    direction: tuple[int, int],
) -> tuple[int, int]:
    """Take an edge that starts here: where two cells touch at a corner, that of the same cell."""
    right = -direction[1], direction[0]
    choices = edges[here]
    taken = right if right in choices else choices[0]
    choices.remove(taken)
    if not choices:
        del edges[here]
    return taken


def _is_straight(one: Point, middle: Point, other: Point) -> bool:
    return one[0] == middle[0] == other[0] or one[1] == middle[1] == other[1]
