"""Power spectra of the windows of pictures, and what is averaged of them."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.imaging import channel_mean

# Windows of little and of much contrast differ in how far they rise above the noise.
_CLASSES = 3


def window_powers(image: NDArray[np.float32], fourier: WindowedFourierBasis) -> NDArray[np.float32]:
    """Return the power spectra of a picture's windows, a quarter of a window apart [W, K].

    White noise of variance s^2 has the power s^2.

    Raises
    ------
    InputError
        If the picture is smaller than a window.
    """
    power, _ = fourier.power(channel_mean(image), fourier.window_px // 4)
    return power.reshape(-1, fourier.size)


def mean_by_contrast(
    powers: NDArray[np.floating], fourier: WindowedFourierBasis, classes: int = _CLASSES
) -> NDArray[np.float32]:
    """Average the spectra of windows [W, K] of about the same contrast [classes, K].

    Every window counts alike, whatever its contrast: the mean itself would be that of a few strong
    edges. The averages keep the scale of the noise; the least contrast comes first.
    """
    contrast = powers @ fourier.multiplicity
    members = np.array_split(np.argsort(contrast), min(classes, len(powers)))
    means = [
        (powers[chosen] / contrast[chosen, None]).mean(axis=0) / (1 / contrast[chosen]).mean()
        for chosen in members
    ]
    return np.array(means, np.float32)
