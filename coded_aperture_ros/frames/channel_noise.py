"""Noise of one channel of a whole frame, which deblurring goes by."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames.grey import grey_image
from coded_aperture_ros.frames.noise import KnownNoise, grey_noise
from coded_aperture_ros.frames.patches import PatchGrid, window_brightness

# Side of the windows for the noise of a whole frame, and of those of small frames, px.
_WINDOW_PX = 32
_MIN_WINDOW_PX = 8
# Saturation does not matter for the noise of a frame.
_NEVER_SATURATED = 1e9


def channel_noise(frame: FloatArray, known: KnownNoise) -> float:
    """Standard deviation of one channel's noise in a frame, with its shot noise.

    Parameters
    ----------
    frame : ndarray, float32 [rows, columns] or [rows, columns, 3]
        Linear light; NaN where unknown.
    known : KnownNoise

    Raises
    ------
    InputError
        If the noise has to be estimated and the frame is too small for that.

    Examples
    --------
    >>> channel_noise(np.full((48, 64), 0.5, np.float32), KnownNoise(0.002))
    0.002
    """
    # Sensors sample green the most; the mean of the channels would count their texture thrice.
    grey, _ = grey_image(frame if frame.ndim == 2 else frame[..., 1], _NEVER_SATURATED)
    sigma = known.noise
    if not sigma:
        height, width = grey.shape
        window_px = min(_WINDOW_PX, 2 * (min(height, width) // 2))
        if window_px < _MIN_WINDOW_PX:
            raise InputError(
                f"frame of {width}x{height} px is too small to estimate its noise, give the noise"
            )
        grid = PatchGrid.covering(grey.shape, window_px, window_px)
        sigma = grey_noise(grey, grid, known, brightness=window_brightness(grey, grid)).least
    light = max(float(grey.mean()), 0.0) if known.noise_gain else 0.0
    return float(np.sqrt(sigma**2 + known.noise_gain * light))
