"""Blur sizes for every pixel of a frame, from a map that is smaller and has gaps."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coded_aperture_ros.errors import InputError


def covers_frame(map_shape: tuple[int, ...], frame_shape: tuple[int, ...]) -> bool:
    """Return whether a map has the proportions of a frame, so that it can cover the same view.

    A map that was made smaller has sides that were rounded.
    """
    excess = map_shape[0] * frame_shape[1] - map_shape[1] * frame_shape[0]
    return abs(excess) <= max(frame_shape[:2])


def filled_blur_map(
    blur_size_px: NDArray[np.float32], shape: tuple[int, int]
) -> NDArray[np.float32]:
    """Fill the gaps of a blur map from the nearest known pixel and bring it to `shape`.

    Parameters
    ----------
    blur_size_px : ndarray, float32 [rows, columns]
        Signed blur sizes in pixels of the frame; not finite where unknown.
    shape : (int, int)
        Rows and columns of the frame that the map covers.

    Returns
    -------
    ndarray, float32 of `shape`
        Finite.

    Raises
    ------
    InputError
        If the map is not two-dimensional or nothing in it is known.
    """
    if blur_size_px.ndim != 2 or blur_size_px.size == 0:
        raise InputError(f"blur map: expected [rows, columns], got {list(blur_size_px.shape)}")
    unknown = ~np.isfinite(blur_size_px)
    if unknown.all():
        raise InputError("blur map: no pixel has a known depth, so there is nothing to deblur by")
    filled = np.ascontiguousarray(blur_size_px, np.float32)
    if unknown.any():
        _, (row, column) = ndimage.distance_transform_edt(unknown, return_indices=True)
        filled = filled[row, column]
    if filled.shape != shape:
        filled = cv2.resize(filled, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return filled
