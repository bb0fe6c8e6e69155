"""A bound on free space: what every pixel shows is nearer than it at a stated risk only."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth.levels import Levels

# This share of the probability of the blur sizes, times a power of the risk, lies before the bound:
# on random scenes of the kind and with the mask that it suits least no more pixels are nearer.
SHARE, POWER = 1.2, 0.7
# What a pixel shows may belong to its neighbours, px of the frame.
_AROUND_PX = 4


def near_ends(
    level: FloatArray, levels: Levels, error: float, cell_px: float, pixel_px: float
) -> FloatArray:
    """Return the near end, by an `error`, of the nearest level around every cell of a map.

    Cells are `cell_px` of the frame wide, and what is made of them has pixels of `pixel_px`.
    """
    reach = int(np.ceil((_AROUND_PX + (pixel_px - 1) / 2) / cell_px))
    square, last = np.ones((2 * reach + 1,) * 2, np.uint8), len(levels) - 1
    if levels.nearest_first[0] == 0:
        return np.asarray(np.maximum(cv2.erode(level, square) - np.float32(error), 0))
    return np.asarray(np.minimum(cv2.dilate(level, square) + np.float32(error), last))
