"""The noise of a frame, from the top of its spectrum, where a blurred texture has little left."""

import numpy as np
from numpy.typing import NDArray

# The least textured windows tell the noise best; the very least are there by chance.
_QUANTILE = 0.05
_DARKEST = 0.25
# Noise that is taken too low is fatal for the estimate, too high only costs a little.
_MARGIN = 1.15
# Real frames are not cleaner than this, whatever their spectrum says.
NOISE_FLOOR = 2e-4


def estimate_noise(
    high_power: NDArray[np.float32], shot_variance: NDArray[np.float32] | None = None
) -> float:
    """Estimate the standard deviation of white noise, erring upward.

    Parameters
    ----------
    high_power : ndarray, float32
        Mean power of the highest frequencies of each of a frame's windows; see
        `WindowedFourierBasis.noise_weights`.
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
