"""Depth edges: how far each pixel is from one."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray

EDGE_JUMP_PX = 1.0


def edge_distance_px(
    blur_size_px: NDArray[np.floating], jump_px: float = EDGE_JUMP_PX
) -> DoubleArray:
    """Return every pixel's distance from the nearest depth edge; infinite without one.

    Parameters
    ----------
    blur_size_px : ndarray of float, shape [h, w]
        Signed blur size, NaN where unknown. Borders of what is unknown are no edges.
    jump_px : float
        A depth edge is a larger jump between neighbours; the pixels of both its sides are 0 away.
    """
    lowest, highest = lowest_and_highest(blur_size_px)
    edges = highest - lowest > jump_px
    return distance_to_px(edges & np.isfinite(blur_size_px))


def lowest_and_highest(blur_size_px: NDArray[np.floating]) -> tuple[DoubleArray, DoubleArray]:
    """Least and the greatest known value of every pixel's 3 x 3 neighbours."""
    known = np.isfinite(blur_size_px)
    lowest = ndimage.minimum_filter(np.where(known, blur_size_px, np.inf), 3)
    highest = ndimage.maximum_filter(np.where(known, blur_size_px, -np.inf), 3)
    return lowest, highest


def distance_to_px(pixels: BoolArray) -> DoubleArray:
    """Return every pixel's distance from the nearest of some pixels; infinite without one."""
    if not pixels.any():  # the transform would measure to a point outside of the picture
        return np.full(pixels.shape, np.inf)
    distance: DoubleArray = ndimage.distance_transform_edt(~pixels)
    return distance
