"""Focus after the shot: an all-in-focus frame and its depth, blurred as another lens would."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray

# Layers of equal blur: one for so many pixels of radius, and no more than so many.
_LAYER_PX, _LAYERS = 1.0, 20
_BARELY_PX, _COARSE_PX = 0.4, 5.0


def refocused(
    sharp: FloatArray, depth_m: FloatArray, focus_m: float, opening_px: float
) -> FloatArray:
    """Return the picture of a lens with a round opening that is focused elsewhere.

    Layers of about equal blur are laid over each other from the farthest to the nearest. What is
    hidden in the frame stays unknown: around nearer things, what is visible beside it stands in.

    Parameters
    ----------
    sharp : ndarray, float32 [rows, columns, 3] or [rows, columns]
        All in focus, linear light.
    depth_m : ndarray, float32 [rows, columns]
        Metres; what is not finite has the depth of the nearest pixel that is known.
    focus_m : float
    opening_px : float
        Radius of the blur of the nearest depth when the farthest is in focus.

    Returns
    -------
    ndarray, float32, of the shape of `sharp`
        The same picture if no depth is known, or all of it is at one distance and that in focus.
    """
    known = np.isfinite(depth_m) & (depth_m > 0)
    if not known.any():
        return sharp
    nearness = 1 / _filled(depth_m, known)
    least, most = np.percentile(nearness[known], [1, 99])
    radius = opening_px * (nearness - 1 / focus_m) / max(most - least, 1e-6 * most)
    radius = np.clip(radius, -2 * opening_px, 2 * opening_px)
    low, high = float(radius.min()), float(radius.max())
    count = int(np.clip(np.ceil((high - low) / _LAYER_PX), 1, _LAYERS))
    layer = np.minimum(((radius - low) / max(high - low, 1e-6) * count).astype(int), count - 1)
    light = sharp if sharp.ndim == 3 else sharp[..., None]
    found = np.zeros((*light.shape[:2], light.shape[2] + 1), np.float32)
    for index in range(count):
        inside = layer == index
        if not inside.any():
            continue
        here = inside.astype(np.float32)[..., None]
        of_layer = np.concatenate([light * here, here], axis=2)
        blurred = _through_a_disk(of_layer, abs(float(radius[inside].mean())))
        found = found * (1 - blurred[..., -1:]) + blurred
    found = found[..., :-1] / np.maximum(found[..., -1:], 1e-3)
    return np.asarray(found.reshape(sharp.shape), np.float32)


def _filled(depth_m: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    _, labels = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(labels.max() + 1, np.float32)
    of_label[labels[known]] = depth_m[known]
    return of_label[labels]


def _through_a_disk(values: FloatArray, radius: float) -> FloatArray:
    """Return the mean over a disk around every pixel, whose edge is smooth."""
    if radius < _BARELY_PX:
        return values
    if radius > _COARSE_PX:  # nothing fine is left to see
        rows, columns = values.shape[:2]
        half = cv2.resize(values, (-(-columns // 2), -(-rows // 2)), interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.resize(_through_a_disk(half, radius / 2), (columns, rows)))
    reach = int(np.ceil(radius))
    places = np.arange(-reach, reach + 1)
    disk = np.clip(radius + 0.5 - np.hypot(*np.meshgrid(places, places)), 0, 1)
    kernel = (disk / disk.sum()).astype(np.float32)
    return np.asarray(cv2.filter2D(values, -1, kernel, borderType=cv2.BORDER_REPLICATE))
