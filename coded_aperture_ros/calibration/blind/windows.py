"""Power spectra of the windows of pictures, and what is averaged of them."""

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.bank.fourier import WindowedFourierBasis

# Windows of little and of much contrast differ in how far they rise above the noise.
_CLASSES = 3


def window_powers(
    image: NDArray[np.float32], fourier: WindowedFourierBasis, stride_px: int
) -> NDArray[np.float64]:
    """Return the power spectra of all windows of a grey picture.

    Parameters
    ----------
    image : ndarray, float32 [rows, columns]
        Not smaller than a window.
    fourier : WindowedFourierBasis
    stride_px : int
        From one window to the next.

    Returns
    -------
    ndarray, float64 [windows, K]
        As `WindowedFourierBasis.project` orders them; white noise of variance s^2 has power s^2.
    """
    n = fourier.window_px
    windows = np.lib.stride_tricks.sliding_window_view(image, (n, n))[::stride_px, ::stride_px]
    weights = np.outer(fourier.window, fourier.window)
    power = np.abs(scipy.fft.rfft2(windows.reshape(-1, n, n) * weights)) ** 2
    return np.asarray(power.reshape(len(power), -1), np.float64)


def mean_by_contrast(
    powers: NDArray[np.float64], fourier: WindowedFourierBasis, classes: int = _CLASSES
) -> NDArray[np.float32]:
    """Average the spectra of windows of about the same contrast.

    Every window counts alike, whatever its contrast: the mean itself would be that of a few strong
    edges. The averages keep the scale of the noise.

    Parameters
    ----------
    powers : ndarray, float64 [windows, K]
    fourier : WindowedFourierBasis
    classes : int, optional
        How many averages.

    Returns
    -------
    ndarray, float32 [classes, K]
        Least contrast first; fewer where there are fewer windows.
    """
    contrast = powers @ fourier.multiplicity
    members = np.array_split(np.argsort(contrast), min(classes, len(powers)))
    means = [
        (powers[chosen] / contrast[chosen, None]).mean(axis=0) / (1 / contrast[chosen]).mean()
        for chosen in members
    ]
    return np.array(means, np.float32)
