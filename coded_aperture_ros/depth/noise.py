"""The noise of a frame, from the top of its spectrum, where a blurred texture has little left."""

import numpy as np
from numpy.typing import NDArray

# The least textured windows tell the noise best; the very least are there by chance.
_QUANTILE = 0.05
# Noise that is taken too low is fatal for the estimate, too high only costs a little.
_MARGIN = 1.15
# Real frames are not cleaner than this, whatever their spectrum says.
NOISE_FLOOR = 2e-4


def estimate_noise(high_power: NDArray[np.float32]) -> float:
    """Estimate the standard deviation of white noise, erring upward.

    Parameters
    ----------
    high_power : ndarray, float32
        Mean power of the highest frequencies of each of a frame's windows; see
        `WindowedFourierBasis.noise_weights`.

    Returns
    -------
    float
        At least `NOISE_FLOOR`.
    """
    return max(_MARGIN * float(np.sqrt(np.quantile(high_power, _QUANTILE))), NOISE_FLOOR)
