"""The relative error of depth, and what of it is published."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.run import Row
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth import DepthConfig, DepthEstimate

# Depth of this confidence is published.
PUBLISHED = DepthConfig().confidence_threshold
# Up to these relative errors depth is right, and exact.
RIGHT = 0.1
EXACT = 0.05


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
