"""The noise of a frame, from the top of its spectrum, where a blurred texture has little left."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.imaging.patches import PatchGrid, mean_at

# Passes what alternates from pixel to pixel along rows and columns both, and white noise with its
# variance unchanged: a texture, blurred or not, has next to nothing there. A sharper filter would
# miss noise that a sensor's colour filters have smoothed.
_ALTERNATING = (np.array([1, -2, 1]) / np.sqrt(6)).astype(np.float32)

# The least textured windows tell the noise best; the very least are there by chance.
_QUANTILE = 0.05
_DARKEST = 0.25
# Noise that is taken too low is fatal for the estimate, too high only costs a little.
_MARGIN = 1.2
# Real frames are not cleaner than this, whatever their spectrum says.
NOISE_FLOOR = 2e-4


def high_power(grey: NDArray[np.float32], grid: PatchGrid) -> NDArray[np.float32]:
    """Return the mean power of the highest frequencies around every patch.

    Parameters
    ----------
    grey : ndarray, float32 [height, width]
        The frame.
    grid : PatchGrid
        Where its patches lie.

    Returns
    -------
    ndarray, float32 [rows, columns]
        The variance of the noise, and what little there is of texture.
    """
    passed = cv2.sepFilter2D(grey, -1, _ALTERNATING, _ALTERNATING)
    cv2.multiply(passed, passed, passed)
    return mean_at(passed, grid, grid.window_px * 3 // 4)


def estimate_noise(
    high_power: NDArray[np.float32], shot_variance: NDArray[np.float32] | None = None
) -> float:
    """Estimate the standard deviation of white noise, erring upward.

    Parameters
    ----------
    high_power : ndarray, float32
        Of each of a frame's windows; see `high_power`.
    shot_variance : ndarray, float32 of the same shape, optional
        Variance of what is known of the noise, and left out of the estimate: its shot noise.

    Returns
    -------
    float
        At least `NOISE_FLOOR`.
    """
    variance = _MARGIN**2 * high_power
    if shot_variance is not None:
        # Where there is much light, its noise hides the rest.
        darkest = shot_variance <= np.quantile(shot_variance, _DARKEST)
        variance = (variance - shot_variance)[darkest]
    return float(np.sqrt(max(np.quantile(variance, _QUANTILE), NOISE_FLOOR**2)))
