"""Refocusing: the picture of another lens, from an all-in-focus picture and its depth."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray

# Radii of blur are grouped in layers of this width, px, and in so many at most.
_LAYER_PX = 1.0
_MOST_LAYERS = 20
# A blur of a smaller radius is left out, px.
_LEAST_RADIUS_PX = 0.4
# A blur of a larger radius is computed at half the resolution, px.
_HALF_RESOLUTION_PX = 5.0


def refocused(
    sharp: FloatArray, depth_m: FloatArray, focus_m: float, opening_px: float
) -> FloatArray:
    """Picture of a lens with a round opening that is focused at another distance.

    Layers of about equal blur are composed from the farthest to the nearest. Occluded background
    is unknown: around nearer objects, the visible background beside it is blurred in its place.

    Parameters
    ----------
    sharp : ndarray, float32 [rows, columns, 3] or [rows, columns]
        All-in-focus picture, linear light.
    depth_m : ndarray, float32 [rows, columns]
        Metres; a pixel without finite depth has that of the nearest one with it.
    focus_m : float
        Distance in focus.
    opening_px : float
        Radius of the blur of the nearest depth if the farthest is in focus.

    Returns
    -------
    ndarray, float32, of the shape of `sharp`
        `sharp` itself if no depth is known.
    """
    known = np.isfinite(depth_m) & (depth_m > 0)
    if not known.any():
        return sharp
    nearness = 1 / _fill_nearest(depth_m, known)
    least, most = np.percentile(nearness[known], [1, 99])
    radius = opening_px * (nearness - 1 / focus_m) / max(most - least, 1e-6 * most)
    radius = np.clip(radius, -2 * opening_px, 2 * opening_px)
    low = float(radius.min())
    high = float(radius.max())
    count = int(np.clip(np.ceil((high - low) / _LAYER_PX), 1, _MOST_LAYERS))
    layer = np.minimum(((radius - low) / max(high - low, 1e-6) * count).astype(int), count - 1)
    light = sharp if sharp.ndim == 3 else sharp[..., None]
    # Colours, and in the last channel the coverage of the layers so far.
    composed = np.zeros((*light.shape[:2], light.shape[2] + 1), np.float32)
    for index in range(count):
        inside = layer == index
        if not inside.any():
            continue
        mask = inside.astype(np.float32)[..., None]
        masked = np.concatenate([light * mask, mask], axis=2)
        blurred = _disk_blur(masked, abs(float(radius[inside].mean())))
        composed = composed * (1 - blurred[..., -1:]) + blurred
    picture = composed[..., :-1] / np.maximum(composed[..., -1:], 1e-3)
    return np.asarray(picture.reshape(sharp.shape), np.float32)


def _fill_nearest(depth_m: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Depth map in which each unknown pixel has the depth of the nearest known one."""
    _, labels = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    label_depths_m = np.zeros(labels.max() + 1, np.float32)
    label_depths_m[labels[known]] = depth_m[known]
    return label_depths_m[labels]


def _disk_blur(values: FloatArray, radius: float) -> FloatArray:
    """Mean over a disk around every pixel, with a smooth edge; radius in pixels."""
    if radius < _LEAST_RADIUS_PX:
        return values
    if radius > _HALF_RESOLUTION_PX:  # no fine detail is left
        rows, columns = values.shape[:2]
        half = cv2.resize(values, (-(-columns // 2), -(-rows // 2)), interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.resize(_disk_blur(half, radius / 2), (columns, rows)))
    reach = int(np.ceil(radius))
    offsets = np.arange(-reach, reach + 1)
    disk = np.clip(radius + 0.5 - np.hypot(*np.meshgrid(offsets, offsets)), 0, 1)
    kernel = (disk / disk.sum()).astype(np.float32)
    return np.asarray(cv2.filter2D(values, -1, kernel, borderType=cv2.BORDER_REPLICATE))
