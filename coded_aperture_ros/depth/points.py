"""Point cloud of a depth map, and its nearest obstacle."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.depth.estimate import DepthEstimate
from coded_aperture_ros.frames import Gamma
from coded_aperture_ros.io.messages import pixels_from_frame
from coded_aperture_ros.optics import Intrinsics

# Names of the values of a point.
POINT_FIELDS = ("x", "y", "z", "rgb", "confidence", "std_dev")
# Every second row and column of a map: obstacles cover neighbouring pixels, so a quarter is enough.
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
    """Points of a depth map in the optical frame (x right, y down, z forward), with colour.

    Parameters
    ----------
    depth_m : ndarray, float32 [rows, columns]
        Metres along the optical axis; NaN where unknown, +inf beyond the range, -inf too near.
    confidence, std_dev_m : ndarray, float32 [rows, columns]
        Probability that the depth is right, and its standard deviation in metres.
    colours : ndarray, uint8 [rows, columns, RGB]
    rays : ndarray, float32 [rows, columns, 2]
        See `optics.distortion.pixel_rays`.
    near_m, far_m : float, optional
        Distances given to pixels that are too near and beyond the range, m; 0: no point.

    Returns
    -------
    ndarray, float32 [rows, columns, 6]
        x, y, z in metres, NaN where there is no point; the bits of 0x00RRGGBB; confidence, and
        standard deviation in metres.

    Examples
    --------
    >>> import numpy as np
    >>> depth_m = np.array([[2.0, np.nan]], np.float32)
    >>> rays = np.array([[[0.1, 0.0], [0.2, 0.0]]], np.float32)
    >>> ones = np.ones_like(depth_m)
    >>> points = points_of_depth(depth_m, ones, 0.1 * ones, np.zeros((1, 2, 3), np.uint8), rays)
    >>> points[0, :, :3].tolist()
    [[0.20000000298023224, 0.0, 2.0], [nan, nan, nan]]
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


def point_colours(light: FloatArray, size: Shape, gamma: Gamma) -> NDArray[np.uint8]:
    """Colours of the pixels of a map of some rows and columns, uint8 [rows, columns, RGB].

    `light` is that of the frame, linear.
    """
    small = cv2.resize(light, size[::-1], interpolation=cv2.INTER_AREA)
    return pixels_from_frame(small, "rgb8", gamma)


def points_of_frame(
    estimate: DepthEstimate, light: FloatArray, intrinsics: Intrinsics, gamma: Gamma
) -> FloatArray:
    """Points of a metric estimate of a frame, with colours; see `points_of_depth`.

    `intrinsics` are those of the frame, in any size.
    """
    assert estimate.depth_m is not None and estimate.std_dev_m is not None
    rows, columns = estimate.depth_m.shape
    rays = intrinsics.rays(rows, columns)
    maps = estimate.depth_m, estimate.confidence, estimate.std_dev_m
    return points_of_depth(*maps, point_colours(light, (rows, columns), gamma), rays)


def nearest_obstacle_m(
    depth_m: FloatArray, share: float, measured_m: FloatArray | None = None
) -> float:
    """Distance of the nearest obstacle that covers a share of the map, m.

    Parameters
    ----------
    depth_m : ndarray, float32 [rows, columns]
        NaN where unknown; -inf, which is too near to be measured, counts as the nearest.
    share : float
        Share of the map's pixels, in (0, 1], that the obstacle covers at least; it excludes single
        wrong pixels.
    measured_m : ndarray, float32 [rows, columns], optional
        Depth of what is too near, before it became -inf: a little nearer than a range of depths it
        is measured all the same.

    Returns
    -------
    float
        Metres; 0 for what is too near to be measured, +inf if everything known is beyond the
        range, NaN if less than that share of the map is known.

    Examples
    --------
    >>> import numpy as np
    >>> depth_m = np.full((4, 4), 3.0, np.float32)
    >>> depth_m[:2] = 1.5
    >>> nearest_obstacle_m(depth_m, 0.25)
    1.5
    """
    sparse_m = depth_m[::_SPARSE, ::_SPARSE]
    if measured_m is not None and (too_near := sparse_m == -np.inf).any():
        sparse_m = np.where(too_near, measured_m[::_SPARSE, ::_SPARSE], sparse_m)
    known = sparse_m[~np.isnan(sparse_m)]
    count = max(1, math.ceil(share * sparse_m.size))
    if known.size < count:
        return math.nan
    nearest = float(np.partition(known, count - 1)[count - 1])
    return 0.0 if nearest == -math.inf else nearest
