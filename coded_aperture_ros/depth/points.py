"""Points in space from a depth map, and the nearest thing in it."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth.estimate import DepthEstimate
from coded_aperture_ros.frames import Gamma
from coded_aperture_ros.io.messages import pixels_from_frame
from coded_aperture_ros.optics import Camera

_SPARSE = 2


def points_of_depth(
    depth_m: FloatArray,
    confidence: FloatArray,
    std_dev_m: FloatArray,
    colours: NDArray[np.uint8],
    rays: FloatArray,
    near_m: float = 0.0,
    far_m: float = 0.0,
) -> FloatArray:
    """Return the points of a depth map in the optical frame: x right, y down, z forward.

    Parameters
    ----------
    depth_m : ndarray, float32 [rows, columns]
        Metres along the optical axis; NaN where unknown, +inf beyond the range, -inf too near.
    confidence, std_dev_m : ndarray, float32 [rows, columns]
    colours : ndarray, uint8 [rows, columns, RGB]
    rays : ndarray, float32 [rows, columns, 2]
        See `optics.intrinsics.pixel_rays`.
    near_m, far_m : float, optional
        Where to put what is too near and what is beyond the range, metres; 0: it has no point.

    Returns
    -------
    ndarray, float32 [rows, columns, 6]
        x, y, z in metres, NaN where there is no point; the bits of 0x00RRGGBB; confidence, and
        standard deviation in metres.
    """
    z = depth_m.copy()
    z[z == np.inf] = far_m if far_m > 0 else np.nan
    z[z == -np.inf] = near_m if near_m > 0 else np.nan
    points = np.empty((*z.shape, 6), np.float32)
    points[..., :2] = z[..., None] * rays
    points[..., 2] = z
    red, green, blue = np.moveaxis(colours.astype(np.uint32), -1, 0)
    points[..., 3] = (red << 16 | green << 8 | blue).view(np.float32)
    points[..., 4], points[..., 5] = confidence, std_dev_m
    return points


def points_of_frame(
    estimate: DepthEstimate, light: FloatArray, camera: Camera, gamma: Gamma
) -> FloatArray:
    """Return `points_of_depth` of an estimate in metres of a whole view, in the frame's colours."""
    assert estimate.depth_m is not None and estimate.std_dev_m is not None
    rows, columns = estimate.depth_m.shape
    small = cv2.resize(light, (columns, rows), interpolation=cv2.INTER_AREA)
    through = camera.intrinsics.rays(rows, columns)
    maps = estimate.depth_m, estimate.confidence, estimate.std_dev_m
    return points_of_depth(*maps, pixels_from_frame(small, "rgb8", gamma), through)


def nearest_obstacle_m(depth_m: FloatArray, share: float) -> float:
    """Return how far the nearest thing of a certain size is.

    Parameters
    ----------
    depth_m : ndarray, float32 [rows, columns]
        NaN where unknown; -inf, which is too near to be measured, counts as the nearest.
    share : float
        Part of the map's pixels, in (0, 1], that the thing takes up at least: single wrong pixels
        are none.

    Returns
    -------
    float
        Metres; 0 for what is too near to be measured, +inf if everything known is beyond the
        range, NaN if less than that part of the map is known.
    """
    some = depth_m[::_SPARSE, ::_SPARSE]  # things have neighbouring pixels: a quarter will do
    known = some[~np.isnan(some)]
    count = max(1, math.ceil(share * some.size))
    if known.size < count:
        return math.nan
    nearest = float(np.partition(known, count - 1)[count - 1])
    return 0.0 if nearest == -math.inf else nearest
