"""The data term of the thesis taken at its word: one pixel given its neighbours."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.two_pixel.holes import Holes
from coded_aperture_ros.likelihood.two_pixel.model import channel_kernel

_CHANNELS = 2
_LEAST_VARIANCE = 1e-12
# Windows that are a few pixels apart share most of what they see.
_STRIDE_PX = 8


def conditional_levels(
    grey: NDArray[np.float32], holes: Holes, blur_sizes_px: NDArray[np.float64], window_px: int
) -> NDArray[np.intp]:
    """Choose the level whose neighbours tell the most about a pixel (thesis eq. 5.15 to 5.23).

    Kept for comparison. The covariance of a pixel and its N (N - 1) neighbours is what the window
    shows, without a model of texture, noise and openings; the mean of eq. 5.23 over that window is
    then the logarithm of the conditional variance, up to a constant. Where covariances of their own
    accord fall off with the lag, as those of photographs do, the nearest neighbours tell the most.

    Parameters
    ----------
    grey : ndarray, float32 [rows, columns]
    blur_sizes_px : ndarray, float64 [L]
    window_px : int
        Side of the square of the statistics.

    Returns
    -------
    ndarray, intp [rows, columns]
    """
    if grey.ndim != 2 or min(grey.shape) < window_px:
        raise InputError(
            f"frame: expected [rows, columns] of at least {window_px} px, got {list(grey.shape)}"
        )
    rows, columns = grey.shape
    channels = [cv2.filter2D(grey, -1, channel_kernel(channel)) for channel in range(_CHANNELS)]
    energies = []
    for size in blur_sizes_px:
        neighbours = np.unique(np.round(holes.offsets, 9), axis=0) * size
        variances = [_conditional_variance(image, neighbours, window_px) for image in channels]
        energies.append(np.log(variances).sum(axis=0))
    sampled = np.argmin(energies, axis=0)
    return sampled[np.arange(rows) // _STRIDE_PX][:, np.arange(columns) // _STRIDE_PX]


def _conditional_variance(
    image: NDArray[np.float32], neighbours: NDArray[np.float64], window_px: int
) -> NDArray[np.float32]:
    """Return the variance of every few pixels given their neighbours (eq. 5.16)."""
    rows, columns = image.shape
    vector = [image]
    for down, right in neighbours:
        shift = np.array([[1, 0, right], [0, 1, down]], np.float64)
        # Disparities between whole pixels: by linear interpolation.
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        vector.append(
            cv2.warpAffine(
                image, shift, (columns, rows), flags=flags, borderMode=cv2.BORDER_REFLECT
            )
        )
    count = len(vector)
    middle, step = _STRIDE_PX // 2, _STRIDE_PX
    sampled = np.ix_(*(np.minimum(np.arange(0, n, step) + middle, n - 1) for n in image.shape))
    shape = (-(-rows // step), -(-columns // step), count, count)
    covariance = np.empty(shape, np.float32)
    for i in range(count):
        for j in range(i, count):
            mean = cv2.blur(vector[i] * vector[j], (window_px, window_px))[sampled]
            covariance[..., i, j] = covariance[..., j, i] = mean
    covariance += _LEAST_VARIANCE * np.eye(count, dtype=np.float32)
    given = np.linalg.solve(covariance[..., 1:, 1:], covariance[..., 1:, :1])[..., 0]
    explained = (covariance[..., 0, 1:] * given).sum(axis=-1)
    return np.maximum(covariance[..., 0, 0] - explained, np.float32(_LEAST_VARIANCE))
