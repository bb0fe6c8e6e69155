"""The openings of a mask, as a knife would cut them."""

import dataclasses
import functools

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.optics import Mask

# Widths are exact to this part of a cell; for openings made of square cells, exact.
_POINTS_PER_CELL = 4


@dataclasses.dataclass(frozen=True)
class Openings:
    """What the openings of a mask are like.

    Attributes
    ----------
    count : int
        Openings; cells that touch at a corner only are two.
    smallest_width : float
        Diameter of the largest disc within the narrowest opening, as a share of the mask's
        extent: `A / M` of the thesis.
    loose_parts : int
        Closed parts that hang on nothing, and would fall out of a mask cut from cardboard.
    """

    count: int
    smallest_width: float
    loose_parts: int


def open_cells(mask: Mask) -> NDArray[np.bool_]:
    """Return which cells [n, m] let through more than half of the most open one's light."""
    return np.asarray(mask.transmission > 0.5 * mask.transmission.max())


@functools.lru_cache(maxsize=16)  # a search asks for the same mask hundreds of times
def openings_of(mask: Mask) -> Openings:
    """Measure the openings of a mask; see `open_cells`."""
    cells = open_cells(mask)
    framed = np.pad(cells, 1)  # the mask's rim is closed, and holds what touches it
    fine = np.kron(framed, np.ones((_POINTS_PER_CELL, _POINTS_PER_CELL), bool)).astype(np.uint8)
    # Corner points of the fine cells that touch open cells only, and how far each is from a
    # closed one. The nearest point of a closed cell is always such a corner point too.
    inside = fine[:-1, :-1] & fine[1:, :-1] & fine[:-1, 1:] & fine[1:, 1:]
    radius = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    count, labels = cv2.connectedComponents(fine, connectivity=4)
    widest = np.zeros(count)
    np.maximum.at(widest, labels[1:, 1:], radius)
    closed_count, _ = cv2.connectedComponents((~framed).astype(np.uint8), connectivity=4)
    return Openings(
        count=count - 1,
        smallest_width=float(2 * widest[1:].min() / _POINTS_PER_CELL / max(cells.shape)),
        loose_parts=closed_count - 2,  # less what OpenCV counts as background, and the rim
    )
