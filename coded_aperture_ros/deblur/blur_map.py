"""Blur sizes that are safe to deblur by, near depth edges and where the depth may be wrong."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.depth import DEPTH_EDGE_PX

# Sharper specks narrower than this are outliers of the depth, px of the frame.
_SPECK_PX = 9
# How far blur sizes are averaged, px, and how much they may differ on one surface.
_SMOOTH_PX, _SAME_SURFACE_PX = 20, 1.0
# What the model of blur leaves unexplained on a plane without noise: standard deviation, linear
# light.
MODEL_ERROR = 0.0015
# What a change of blur size around a pixel leaves unexplained there, per pixel of its standard
# deviation, linear light; and how far around.
_ERROR_PER_PX, _AROUND_PX = 0.0014, 15


def safe_blur_map(
    blur: NDArray[np.float32], reach_px: float, reduction: int, moves: bool
) -> NDArray[np.float32]:
    """Return the blur sizes that do the least harm where the depth may be wrong.

    `reach_px` says how far its edges may be off, in px of the frame; 0: it is exact. The map is
    `reduction` times smaller. `moves`: something has moved during the exposure.
    """
    if not reach_px:
        return blur
    blur = sharper_near_edges(without_specks(blur, reduction), round(reach_px / reduction))
    return smoothed_over_surfaces(blur) if moves else blur


def without_specks(blur: NDArray[np.float32], reduction: int = 1) -> NDArray[np.float32]:
    """Return blur sizes without small spots that are sharper than all around them."""
    amount = np.abs(blur)
    side = _SPECK_PX // reduction | 1
    square = np.ones((side, side), np.uint8)
    closed = cv2.morphologyEx(amount, cv2.MORPH_CLOSE, square)
    return np.where(closed - amount > DEPTH_EDGE_PX, np.copysign(closed, blur), blur)


def sharper_near_edges(blur: NDArray[np.float32], reach_px: int) -> NDArray[np.float32]:
    """Return blur sizes that near a depth edge are those of its sharper side.

    Where the edge is off, a pixel is deblurred with the PSF of the other side. One that is too
    small leaves some blur, one that is too large rings.
    """
    amount = np.abs(blur)
    least = cv2.erode(amount, np.ones((2 * reach_px + 1,) * 2, np.uint8))
    return np.where(amount - least > DEPTH_EDGE_PX, np.copysign(least, blur), blur)


def smoothed_over_surfaces(blur: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return blur sizes averaged over surfaces, whose edges stay.

    The inverse of a long motion rings where the other blur is wrong by little.
    """
    return np.asarray(cv2.bilateralFilter(blur, 3 * _SMOOTH_PX | 1, _SAME_SURFACE_PX, _SMOOTH_PX))


def model_weight(blur: NDArray[np.float32], noise: float) -> NDArray[np.float32]:
    """Return how far every pixel's data can be trusted, 0 to 1, from the relief around it."""
    least = np.float32(noise**2 + MODEL_ERROR**2)
    return least / (least + np.float32(_ERROR_PER_PX**2) * local_variance(blur, _AROUND_PX))


def local_variance(blur: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """Return the variance of a map in a square around every pixel."""
    # Variances of differences from the overall mean keep their digits in single precision.
    centred = blur - blur.mean()
    variance = cv2.blur(centred * centred, (side, side))
    variance -= cv2.blur(centred, (side, side)) ** 2
    return np.maximum(variance, 0, out=variance)
