"""Blur sizes for every pixel of a frame, from a map that is smaller and has gaps."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DEPTH_EDGE_PX

# A difference in brightness that counts as much as being one pixel of the small map away.
_LIKE_ONE_PIXEL = 0.05


def covers_frame(map_shape: tuple[int, ...], frame_shape: tuple[int, ...]) -> bool:
    """Return whether a map has the proportions of a frame, so that it can cover the same view.

    A map that was made smaller has sides that were rounded.
    """
    excess = map_shape[0] * frame_shape[1] - map_shape[1] * frame_shape[0]
    return abs(excess) <= max(frame_shape[:2])


def filled_blur_map(
    blur_size_px: NDArray[np.float32], frame: NDArray[np.float32], reduction: int = 1
) -> NDArray[np.float32]:
    """Fill the gaps of a blur map and bring it to the size of its frame, or a part of that.

    Gaps, which are not finite, take the value of the nearest known pixel. The frame guides the
    edges of a smaller map. The result is [rows / reduction, columns / reduction], rounded up; its
    values are still in pixels of the frame.

    Raises
    ------
    InputError
        If the map is not two-dimensional, has not the proportions of the frame, or nothing in it
        is known.
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
        blur = _reduced(blur, (columns, rows))  # first: then there is less to fill
    known = np.isfinite(blur)
    if not known.any():
        raise InputError("blur map: no pixel has a known depth, so there is nothing to deblur by")
    if not known.all():
        blur = np.where(known, blur, blur[known][_nearest(known)])
    if blur.shape == (rows, columns):
        return blur
    guide = cv2.resize(frame, (columns, rows), interpolation=cv2.INTER_AREA)
    return _enlarged(blur, guide if guide.ndim == 2 else guide.mean(axis=2))


def _reduced(blur: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """Return a map at a smaller size (columns, rows): means of what is known, NaN without any."""
    known = np.isfinite(blur)
    if known.all():
        return np.asarray(cv2.resize(blur, size, interpolation=cv2.INTER_AREA))
    total = cv2.resize(np.where(known, blur, 0), size, interpolation=cv2.INTER_AREA)
    share = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.divide(total, share, out=np.full_like(total, np.nan), where=share > 0)


def _nearest(source: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return for every pixel the number of the nearest `source`, as a mask of them counts."""
    # A tenth of the time of an exact distance transform; the distances are good to a few per cent.
    _, labels = cv2.distanceTransformWithLabels(
        (~source).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    number = np.zeros(labels.max() + 1, np.intp)
    number[labels[source]] = np.arange(np.count_nonzero(source))
    return number[labels]


def _enlarged(small: NDArray[np.float32], grey: NDArray[np.float32]) -> NDArray[np.float32]:
    """Interpolate a smaller map; across a depth edge each pixel joins the side it looks like."""
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
        unlike = np.abs(guide[at, beside] - grey[rows, columns]) / _LIKE_ONE_PIXEL
        cost = (distance + unlike).astype(np.float32)
        better = cost < least
        least[better] = cost[better]
        smooth[rows[better], columns[better]] = small[at[better], beside[better]]
    return np.asarray(smooth, np.float32)
