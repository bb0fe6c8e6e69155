"""The noise of a frame, from the top of its spectrum, where a blurred texture has little left."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank import WindowedFourierBasis

# Blur has removed most of the texture above this frequency, cycles per pixel.
_HIGH_FREQUENCY = 0.42
# The least textured windows tell the noise best; the very least are there by chance.
_QUANTILE = 0.05
# Noise that is taken too low is fatal for the estimate, too high only costs a little.
_MARGIN = 1.15
# Real frames are not cleaner than this, whatever their spectrum says.
NOISE_FLOOR = 2e-4


def estimate_noise(power: NDArray[np.float32], fourier: WindowedFourierBasis) -> float:
    """Estimate the standard deviation of white noise, erring upward.

    Parameters
    ----------
    power : ndarray, float32 [..., K]
        Power spectra of a frame's windows.
    fourier : WindowedFourierBasis
        The basis that they were computed in.

    Returns
    -------
    float
        At least `NOISE_FLOOR`.
    """
    weight = fourier.multiplicity * (fourier.frequency > _HIGH_FREQUENCY)
    variance = power.reshape(-1, power.shape[-1]) @ (weight / weight.sum())
    return max(_MARGIN * float(np.sqrt(np.quantile(variance, _QUANTILE))), NOISE_FLOOR)
