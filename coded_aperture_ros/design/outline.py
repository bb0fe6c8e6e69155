"""Outlines of a mask's openings: the lines to cut along."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.openings import open_cells
from coded_aperture_ros.optics import Mask

Point = tuple[float, float]
Outline = list[Point]
# Curved masks are stored as coverage of cells; their outline is drawn in steps of this part of a
# cell, for the named masks 1/768 of the extent.
_STEPS_PER_CELL = 8
# How far the area of the outlines may be from the light that the mask lets through, as a share.
_LARGEST_LOSS = 0.02


def outlines_of(mask: Mask) -> list[Outline]:
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
    black_and_white = np.isin(mask.transmission, (0.0, 1.0)).all()
    cells = open_cells(mask) if black_and_white else _fine_cells(mask)
    rows, columns = cells.shape
    extent = max(cells.shape)
    return [
        [((x - columns / 2) / extent, (y - rows / 2) / extent) for x, y in corners]
        for corners in _trace(cells)
    ]


def _fine_cells(mask: Mask) -> NDArray[np.bool_]:
    steps = _STEPS_PER_CELL
    light = cv2.resize(
        np.pad(mask.transmission, 1), None, fx=steps, fy=steps, interpolation=cv2.INTER_LINEAR
    )[steps:-steps, steps:-steps]
    cells = np.asarray(light > 0.5)
    if abs(cells.mean() - mask.transmission.mean()) > _LARGEST_LOSS * mask.transmission.mean():
        raise InputError(
            f"mask {mask.name}: it has grey cells, which cannot be cut; use a picture of black and "
            "white"
        )
    return cells


def _trace(cells: NDArray[np.bool_]) -> list[list[tuple[int, int]]]:
    """Return the corners (x, y) of the outlines of the open cells, each clockwise with y down."""
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
        points, directions = [], []
        while here in edges:
            # Where two cells touch at a corner, the right turn stays at the same cell.
            right, choices = (-direction[1], direction[0]), edges[here]
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
