"""Shares of depths that are off by less than a factor, as the field reports dense depth maps."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError

DELTA_BOUNDS = (1.05, 1.15, 1.25)


def delta_shares(
    depth_m: NDArray[np.floating],
    true_depth_m: NDArray[np.floating],
    bounds: tuple[float, ...] = DELTA_BOUNDS,
) -> dict[float, float]:
    """Return the share of pixels whose depth is off by less than a factor, for several factors.

    Parameters
    ----------
    depth_m, true_depth_m : ndarray of float, of one shape
        Metres. Pixels without a true depth are left out; a depth that is unknown, infinite or not
        positive is wrong.
    bounds : tuple of float
        delta = max(depth / truth, truth / depth) is below this.

    Raises
    ------
    InputError
        If the shapes differ.
    """
    if depth_m.shape != true_depth_m.shape:
        raise InputError(
            f"expected arrays of one shape, got {list(depth_m.shape)} and "
            f"{list(true_depth_m.shape)}"
        )
    with_truth = np.isfinite(true_depth_m) & (true_depth_m > 0)
    depth, truth = depth_m[with_truth], true_depth_m[with_truth]
    if not truth.size:
        return dict.fromkeys(bounds, float("nan"))
    usable = np.isfinite(depth) & (depth > 0)
    ratio = np.divide(depth, truth, out=np.full(truth.shape, np.inf), where=usable)
    delta = np.maximum(ratio, 1 / ratio)
    return {bound: float(np.mean(delta < bound)) for bound in bounds}
