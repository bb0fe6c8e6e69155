"""How far a view is free, as the frames of a moving camera have shown it together."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth.moving.belief import Belief

# Side of the square in which nothing may be nearer, px of the belief's map: edges are that wrong.
_AROUND_PX = 9
# What may be nearer than it is believed: by this share, and by so many standard deviations.
_SHARE, _DEVIATIONS = 0.06, 3.0
# Least confidence that is needed everywhere in the square. Chosen with the others on walks through
# four rooms made by chance, where of a hundred thousand pixels one was nearer.
_SURE = 0.9
_LEAST_INVERSE = np.float32(1e-3)


def clearance_m(belief: Belief) -> FloatArray:
    """Depth up to which nothing is, m, float32 [rows, columns]; 0 where that is not known.

    Examples
    --------
    >>> sure, unsure = (np.full((12, 12), value, np.float32) for value in (0.95, 0.5))
    >>> depth = np.full((12, 12), 0.5, np.float32), np.zeros((12, 12), np.float32)
    >>> [round(float(clearance_m(Belief(*depth, each))[6, 6]), 2) for each in (sure, unsure)]
    [1.89, 0.0]
    """
    around = np.ones((_AROUND_PX, _AROUND_PX), np.uint8)
    nearest = belief.inverse * np.float32(1 + _SHARE)
    nearest += np.float32(_DEVIATIONS) * np.sqrt(belief.variance)
    nearest = np.maximum(cv2.dilate(nearest, around), _LEAST_INVERSE)
    is_sure = cv2.erode(belief.confidence, around) > _SURE
    return np.where(is_sure, 1 / nearest, np.float32(0))
