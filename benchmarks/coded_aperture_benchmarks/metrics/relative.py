"""The relative error of depth, and what of it is published."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.run import Row
from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.depth import DepthConfig, DepthEstimate

# Depth of this confidence is published.
PUBLISHED = DepthConfig().confidence_threshold
# Up to these relative errors depth is right, and exact.
RIGHT = 0.1
EXACT = 0.05
# What is published is wrong: a median error above this, at a coverage above that.
WRONG = 0.1
COVERED = 0.2
_FEWEST = 50


def relative_error(estimate: DepthEstimate, true_m: NDArray[np.floating]) -> FloatArray:
    """Return |depth / truth - 1| [rows, columns]; NaN where either is unknown."""
    assert estimate.depth_m is not None  # there is a camera, or a bank with depths
    return np.asarray(np.abs(estimate.depth_m / true_m - 1))


def published_shares(error: FloatArray, confidence: FloatArray) -> Row:
    """Return shares of some pixels, from their relative errors and confidences [n].

    right : of all, an unknown depth is wrong; published : of all; right_of_published,
    exact_of_published : of those; said : their mean confidence. The last three are None where
    nothing is published.
    """
    sure = confidence >= PUBLISHED
    right, exact = (error <= bound for bound in (RIGHT, EXACT))

    def of_published(values: NDArray) -> float | None:
        return float(np.mean(values[sure])) if sure.any() else None

    return {
        "right": float(np.mean(right)),
        "published": float(np.mean(sure)),
        "right_of_published": of_published(right),
        "exact_of_published": of_published(exact),
        "said": of_published(confidence),
    }


def published(error: FloatArray, confidence: FloatArray, known: BoolArray) -> Row:
    """Return the median relative error (None: too few pixels), the coverage, and if it is wrong.

    Of the pixels whose truth is `known`; maps are of one shape.
    """
    sure = known & (confidence >= PUBLISHED)
    median = float(np.median(error[sure])) if sure.sum() > _FEWEST else None
    coverage = float(sure.sum() / max(known.sum(), 1))
    return {
        "error": None if median is None else round(median, 4),
        "coverage": round(coverage, 4),
        "wrong": bool(median is not None and median > WRONG and coverage > COVERED),
    }
