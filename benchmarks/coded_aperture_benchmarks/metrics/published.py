"""What of a depth map is published at the default threshold, and whether it is wrong."""

import numpy as np

from coded_aperture_benchmarks.run import Row
from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.depth import DepthConfig

THRESHOLD = DepthConfig().confidence_threshold
# Wrong: a median error above this, at a coverage above that.
WRONG, COVERED = 0.1, 0.2
_FEWEST = 50


def published(error: FloatArray, confidence: FloatArray, known: BoolArray) -> Row:
    """Return the median relative error (None: too few pixels), the coverage, and if it is wrong.

    Of the pixels whose truth is `known`; maps are of one shape.
    """
    sure = known & (confidence >= THRESHOLD)
    median = float(np.median(error[sure])) if sure.sum() > _FEWEST else None
    coverage = float(sure.sum() / max(known.sum(), 1))
    return {
        "error": None if median is None else round(median, 4),
        "coverage": round(coverage, 4),
        "wrong": bool(median is not None and median > WRONG and coverage > COVERED),
    }
