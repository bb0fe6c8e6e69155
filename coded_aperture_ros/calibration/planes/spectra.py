"""The power spectra of the windows of textured planes."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.core.errors import InputError

# A window has texture if its power, relative to the noise, is at least this.
_TEXTURE_OVER_NOISE = 4.0
_LEAST_TEXTURED = 0.2
# Real pictures are not cleaner than this.
_LEAST_NOISE = 2e-4


def plane_spectra(planes: Planes, fourier: WindowedFourierBasis) -> list[NDArray[np.float32]]:
    """Return the power spectra of every plane's windows, a quarter of a window apart [W, K].

    Raises
    ------
    InputError
        If a plane has no texture above its noise, or is smaller than a window.
    """
    return [
        _textured_power(fourier, image, name)
        for image, name in zip(planes.images, planes.names, strict=True)
    ]


def _textured_power(
    fourier: WindowedFourierBasis, image: NDArray[np.float32], name: str
) -> NDArray[np.float32]:
    """Return the power spectra of one plane [W, K]; refuse a plane without texture."""
    grey = image if image.ndim == 2 else image.mean(axis=2, dtype=np.float32)
    try:
        power, _ = fourier.project(
            np.ascontiguousarray(grey, np.float32),
            fourier.window_px // 4,
            np.eye(fourier.size, dtype=np.float32),
        )
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    power = power.reshape(-1, fourier.size)
    noise = max(float(np.quantile(power @ fourier.noise_weights, 0.05)), _LEAST_NOISE**2)
    mean_power = power @ fourier.multiplicity / fourier.multiplicity.sum()
    textured = np.mean(mean_power > _TEXTURE_OVER_NOISE * noise)
    if not textured >= _LEAST_TEXTURED:
        contrast = np.sqrt(max(float(np.median(mean_power)) - noise, 0.0))
        raise InputError(
            f"{name}: contrast {contrast:.2g} is not above the noise of {np.sqrt(noise):.2g} in "
            f"{1 - textured:.0%} of the picture: use a page with fine texture all over, and "
            "more light"
        )
    return power
