"""A bound on free space: what every pixel shows is nearer than it at a stated risk only."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth.decision import Decision
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.refine.features import BLUR_STEP_PX

# This share of the probability of the levels, times a power of the risk, lies before the bound: on
# random scenes of the kind and with the mask that it suits least no more pixels are nearer.
_SHARE, _POWER = 1.2, 0.7
# What a pixel shows may belong to its neighbours, px of the frame.
_AROUND_PX = 4


def free_level(
    level: FloatArray, decided: Decision, levels: Levels, risk: float, scale: float
) -> FloatArray:
    """Return the level that every pixel of a map is nearer than at a risk.

    It is not farther than the `level` that is given. The map is `scale` times the frame.
    """
    nearest, last = levels.nearest_first[0], len(levels) - 1
    level = levels.nearer(level, decided.nearest_plausible(_SHARE * risk**_POWER))
    square = np.ones((2 * round(_AROUND_PX * scale) + 1,) * 2, np.uint8)
    # What is nearer than a level by less than half a step is of that level, too.
    half = max(0.5, BLUR_STEP_PX / 2 / float(np.abs(np.diff(levels.blur_sizes_px)).mean()))
    if nearest == 0:
        return np.asarray(np.maximum(cv2.erode(level, square) - np.float32(half), 0))
    return np.asarray(np.minimum(cv2.dilate(level, square) + np.float32(half), last))
