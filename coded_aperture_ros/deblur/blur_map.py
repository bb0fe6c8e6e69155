"""Blur map of a frame: without gaps, and conservative where the depth may be wrong."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DEPTH_EDGE_PX

# Difference in brightness, linear light, that counts as a distance of one pixel of the small map.
_BRIGHTNESS_PER_PX = 0.05
# Sharper specks narrower than this are outliers of the depth, px of the frame.
_MAX_SPECK_PX = 9
# How far blur sizes are averaged, px, and how much they may differ on one surface.
_SMOOTH_PX = 20
_SAME_SURFACE_PX = 1.0
# What the model of blur leaves unexplained on a plane without noise: standard deviation, linear
# light.
MODEL_ERROR = 0.0015
# What a change of blur size around a pixel leaves unexplained there, per pixel of its standard
# deviation, linear light; and how far around.
_ERROR_PER_PX = 0.0014
_AROUND_PX = 15


def covers_frame(map_shape: tuple[int, ...], frame_shape: tuple[int, ...]) -> bool:
    """Whether a map has the proportions of a frame, so that it can cover the same view.

    The sides of a smaller map are rounded.

    Examples
    --------
    >>> covers_frame((240, 320), (480, 640, 3)), covers_frame((240, 240), (480, 640))
    (True, False)
    """
    excess = map_shape[0] * frame_shape[1] - map_shape[1] * frame_shape[0]
    return abs(excess) <= max(frame_shape[:2])


def filled_blur_map(blur_size_px: FloatArray, frame: FloatArray, reduction: int = 1) -> FloatArray:
    """Blur map without gaps [rows / reduction, columns / reduction], rounded up, px of the frame.

    Gaps, which are not finite, get the value of the nearest known pixel. The frame guides the edges
    of a smaller map.

    Raises
    ------
    InputError
        If the map is not two-dimensional, has other proportions than the frame, or nothing in it is
        known.
    """
    if blur_size_px.ndim != 2 or blur_size_px.size == 0:
        raise InputError(f"blur map: expected [rows, columns], got {list(blur_size_px.shape)}")
    if not covers_frame(blur_size_px.shape, frame.shape):
        raise InputError(
            f"blur map of {blur_size_px.shape[1]}x{blur_size_px.shape[0]} px does not have the "
            f"proportions of the frame of {frame.shape[1]}x{frame.shape[0]} px: give the map of "
            "this frame, of its size or smaller"
        )
    rows, columns = (-(-length // reduction) for length in frame.shape[:2])
    blur = np.ascontiguousarray(blur_size_px, np.float32)
    if len(blur) > rows:
        blur = _downsample(blur, (columns, rows))  # first: then there is less to fill
    known = np.isfinite(blur)
    if not known.any():
        raise InputError("blur map: no pixel has a known depth, so the frame cannot be deblurred")
    if not known.all():
        blur = np.where(known, blur, blur[known][nearest_index(known)])
    if blur.shape == (rows, columns):
        return blur
    guide = cv2.resize(frame, (columns, rows), interpolation=cv2.INTER_AREA)
    return _upsample_guided(blur, guide if guide.ndim == 2 else guide.mean(axis=2))


def _downsample(blur: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Map of a smaller size (columns, rows): means of what is known, NaN without any."""
    known = np.isfinite(blur)
    if known.all():
        return np.asarray(cv2.resize(blur, size, interpolation=cv2.INTER_AREA))
    total = cv2.resize(np.where(known, blur, 0), size, interpolation=cv2.INTER_AREA)
    share = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.divide(total, share, out=np.full_like(total, np.nan), where=share > 0)


def nearest_index(source: BoolArray) -> IndexArray:
    """Index of the nearest `source` for each pixel, in the order of ``source.nonzero()``."""
    # A tenth of the time of an exact distance transform; the distances are good to a few per cent.
    _, labels = cv2.distanceTransformWithLabels(
        (~source).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    number = np.zeros(labels.max() + 1, np.intp)
    number[labels[source]] = np.arange(np.count_nonzero(source))
    return number[labels]


def _upsample_guided(small: FloatArray, grey: FloatArray) -> FloatArray:
    """Larger map [rows, columns]; at a depth edge each pixel joins the side of its brightness."""
    size = grey.shape[::-1]
    smooth = cv2.resize(small, size, interpolation=cv2.INTER_LINEAR)
    around = np.ones((3, 3), np.uint8)
    relief = cv2.dilate(small, around) - cv2.erode(small, around)
    edge = cv2.resize(relief, size, interpolation=cv2.INTER_NEAREST) > DEPTH_EDGE_PX
    rows, columns = np.nonzero(edge)
    if not rows.size:
        return np.asarray(smooth, np.float32)
    guide = cv2.resize(grey, small.shape[::-1], interpolation=cv2.INTER_AREA)
    row = (rows + 0.5) * small.shape[0] / grey.shape[0] - 0.5
    column = (columns + 0.5) * small.shape[1] / grey.shape[1] - 0.5
    least = np.full(rows.size, np.inf, np.float32)
    for down, right in np.ndindex(2, 2):
        at = np.clip(np.floor(row).astype(np.intp) + down, 0, small.shape[0] - 1)
        beside = np.clip(np.floor(column).astype(np.intp) + right, 0, small.shape[1] - 1)
        distance = np.hypot(row - at, column - beside)
        unlike = np.abs(guide[at, beside] - grey[rows, columns]) / _BRIGHTNESS_PER_PX
        cost = (distance + unlike).astype(np.float32)
        better = cost < least
        least[better] = cost[better]
        smooth[rows[better], columns[better]] = small[at[better], beside[better]]
    return np.asarray(smooth, np.float32)


def known_pixels(blur_size_px: FloatArray, shape: tuple[int, ...]) -> BoolArray:
    """Mask [rows, columns] of the pixels of a frame of `shape` for which a map has a value."""
    known = np.isfinite(blur_size_px).astype(np.uint8)
    size = (shape[1], shape[0])
    return cv2.resize(known, size, interpolation=cv2.INTER_NEAREST_EXACT) > 0


def safe_blur_map(blur: FloatArray, reach_px: int, reduction: int) -> FloatArray:
    """Blur sizes that do the least harm where the depth may be wrong.

    `reach_px` is the possible error of depth edges, px of the frame; 0 for methods that detect
    wrong depth themselves. The map is `reduction` times smaller.
    """
    if not reach_px:
        return blur
    return sharpen_edges(remove_specks(blur, reduction), round(reach_px / reduction))


def remove_specks(blur: FloatArray, reduction: int = 1) -> FloatArray:
    """Blur sizes without small spots that are sharper than all around them."""
    amount = np.abs(blur)
    side = _MAX_SPECK_PX // reduction | 1
    square = np.ones((side, side), np.uint8)
    closed = cv2.morphologyEx(amount, cv2.MORPH_CLOSE, square)
    return np.where(closed - amount > DEPTH_EDGE_PX, np.copysign(closed, blur), blur)


def sharpen_edges(blur: FloatArray, reach_px: int) -> FloatArray:
    """Blur sizes that near a depth edge are those of its sharper side.

    Where the edge is off, a pixel is deblurred with the PSF of the other side. One that is too
    small leaves some blur, one that is too large rings.
    """
    amount = np.abs(blur)
    least = cv2.erode(amount, np.ones((2 * reach_px + 1,) * 2, np.uint8))
    return np.where(amount - least > DEPTH_EDGE_PX, np.copysign(least, blur), blur)


def smooth_within_surfaces(blur: FloatArray) -> FloatArray:
    """Blur sizes averaged over surfaces, with their edges.

    The inverse of a long motion rings where the blur size is slightly wrong.
    """
    return np.asarray(cv2.bilateralFilter(blur, 3 * _SMOOTH_PX | 1, _SAME_SURFACE_PX, _SMOOTH_PX))


def model_weight(blur: FloatArray, noise: float) -> FloatArray:
    """Weight of each pixel's data, 0 to 1, from the relief around it."""
    least = np.float32(noise**2 + MODEL_ERROR**2)
    return least / (least + np.float32(_ERROR_PER_PX**2) * local_variance(blur, _AROUND_PX))


def local_variance(blur: FloatArray, side: int) -> FloatArray:
    """Variance of a map in a square around each pixel."""
    # Variances of differences from the overall mean keep their digits in single precision.
    centred = blur - blur.mean()
    variance = cv2.blur(centred * centred, (side, side))
    variance -= cv2.blur(centred, (side, side)) ** 2
    return np.maximum(variance, 0, out=variance)
