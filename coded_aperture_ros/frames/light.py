"""Linear light of stored pixels: transfer curves, and the noise of compression in light."""

import logging

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError

# An exponent (stored value = light ** (1 / gamma)), or the sRGB transfer curve.
Gamma = float | str
SRGB = "srgb"
_ASSUMED = (
    "hint: 8-bit pictures are taken for linear light; give --gamma srgb for those of ordinary "
    "cameras, or --gamma 1 if they are linear"
)
# Linear light, where 1 is white: lamps may be above, half of a picture is not.
_FAR_ABOVE_WHITE = 2.0


class AssumedGamma(float):
    """Gamma that nobody has stated; its first use for 8-bit pictures in a process is logged.

    Pictures of ordinary cameras, taken for linear light, give wrong depth that looks right.

    Examples
    --------
    >>> AssumedGamma(1.0) == 1.0, AssumedGamma(1.0).is_told
    (True, False)
    """

    def __init__(self, _value: float) -> None:
        self.is_told = False

    def tell(self) -> None:
        """Log how to state it, once."""
        if not self.is_told:
            logging.getLogger(__name__).warning(_ASSUMED)
        self.is_told = True


def gamma_from_text(text: str) -> Gamma:
    """Gamma setting of a text: a number or `srgb`.

    Raises
    ------
    InputError
        If it is neither.

    Examples
    --------
    >>> gamma_from_text("2.2"), gamma_from_text("sRGB")
    (2.2, 'srgb')
    """
    if text.strip().lower() == SRGB:
        return SRGB
    try:
        gamma = float(text)
    except ValueError as error:
        raise InputError(f"gamma: expected a number or {SRGB}, got {text!r}") from error
    _check_gamma(gamma)
    return gamma


def decode(stored: ArrayLike, gamma: Gamma) -> FloatArray:
    """Linear light of stored values in [0, 1], float32.

    Examples
    --------
    >>> decode([0.0, 0.5, 1.0], 2.0).tolist()
    [0.0, 0.25, 1.0]
    """
    _check_gamma(gamma)
    values = np.asarray(stored, dtype=np.float32)
    if isinstance(gamma, str):
        curve = ((np.maximum(values, 0.0) + 0.055) / 1.055) ** 2.4
        return np.where(values <= 0.04045, values / 12.92, curve).astype(np.float32)
    return values if gamma == 1.0 else np.maximum(values, 0.0) ** np.float32(gamma)


def encode(light: ArrayLike, gamma: Gamma) -> FloatArray:
    """Stored values of linear light in [0, 1], float32; the inverse of `decode`.

    Examples
    --------
    >>> encode([0.0, 0.25, 1.0], 2.0).tolist()
    [0.0, 0.5, 1.0]
    """
    _check_gamma(gamma)
    values = np.asarray(light, dtype=np.float32)
    if isinstance(gamma, str):
        curve = 1.055 * np.maximum(values, 0.0) ** np.float32(1 / 2.4) - 0.055
        return np.where(values <= 0.0031308, values * 12.92, curve).astype(np.float32)
    return values if gamma == 1.0 else np.maximum(values, 0.0) ** np.float32(1.0 / gamma)


def compression_noise(lost: float, frame: FloatArray, gamma: Gamma) -> float:
    """Standard deviation of the noise that compression has hidden in a frame, linear light.

    Parameters
    ----------
    lost : float
        The same of stored values in [0, 1], see `quantisation_sigma`; 0: none.
    frame : ndarray, float32 [rows, columns] or [rows, columns, 3]
        Linear light; NaN counts as dark.
    gamma : float or "srgb"
        Transfer curve of the stored values.

    Examples
    --------
    >>> round(compression_noise(0.01, np.full((8, 8), 0.25, np.float32), 2.0), 4)
    0.01
    """
    if not lost:
        return 0.0
    light = float(np.nan_to_num(frame[::8, ::8]).mean())
    stored = float(np.clip(encode(light, gamma), 0.05, 0.95))
    low, high = decode(np.array([stored - 0.01, stored + 0.01]), gamma)
    return float(lost * (high - low) / 0.02)


def linear_from_pixels(pixels: NDArray, gamma: Gamma = 1.0) -> FloatArray:
    """Linear light of pixels, float32 of the same shape.

    Parameters
    ----------
    pixels : ndarray, uint8, uint16 or float
        Integers span 0 to their type's maximum; floats, NaN included, are not changed.
    gamma : float or "srgb"
        Transfer curve of 8-bit pixels; wider types are linear.

    Raises
    ------
    InputError
        If the type is another one.

    Examples
    --------
    >>> linear_from_pixels(np.array([0, 65535], np.uint16)).tolist()
    [0.0, 1.0]
    """
    if pixels.dtype == np.uint8 and gamma == 1.0:
        return pixels * np.float32(1 / 255)  # several times faster than a table
    if pixels.dtype == np.uint8:
        return decode(np.arange(256) / 255.0, gamma)[pixels]
    if pixels.dtype == np.uint16:
        return pixels.astype(np.float32) * np.float32(1 / 65535)
    if pixels.dtype.kind == "f":
        return pixels.astype(np.float32)
    raise InputError(f"expected 8-bit, 16-bit or float pixels, got {pixels.dtype}")


def check_linear(values: NDArray) -> None:
    """Raise `InputError` for floats that are not linear light, in which white is 1.

    Examples
    --------
    >>> check_linear(np.float32([0.5, 255.0, 0.9]))
    >>> check_linear(np.float32([20.0, 255.0, 0.9]))
    Traceback (most recent call last):
    ...
    coded_aperture_ros.core.errors.InputError: most values are above 2, ...
    """
    above = (values > _FAR_ABOVE_WHITE) & (values < np.inf)
    if 2 * np.count_nonzero(above) > values.size:
        raise InputError(
            f"most values are above {_FAR_ABOVE_WHITE:g}, expected linear light from 0 to 1: "
            "divide by the value of white, such as 255"
        )


def pixels_from_linear(
    image: NDArray, bits: int, gamma: Gamma = 1.0
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Pixels of 8 or 16 bits of linear light, clipped to [0, 1]; NaN becomes 0.

    Examples
    --------
    >>> pixels_from_linear(np.float32([0.0, 0.5, 2.0, np.nan]), 8).tolist()
    [0, 128, 255, 0]
    """
    values = np.clip(image, 0.0, 1.0)
    unknown = np.isnan(values)
    if unknown.any():
        values[unknown] = 0.0
    stored = encode(values, gamma)
    if bits == 8 and stored.size:
        # One pass scales, rounds and converts, with the same result.
        row = np.ascontiguousarray(stored).reshape(1, -1)
        return np.asarray(cv2.convertScaleAbs(row, alpha=255.0)).reshape(stored.shape)
    maximum, dtype = {8: (255.0, np.uint8), 16: (65535.0, np.uint16)}[bits]
    return np.rint(stored * np.float32(maximum)).astype(dtype)


def _check_gamma(gamma: Gamma) -> None:
    """Raise `InputError` for a gamma out of range."""
    if gamma != SRGB and (isinstance(gamma, str) or not 0.1 <= gamma <= 10.0):
        raise InputError(f"gamma: expected 0.1 to 10 or {SRGB}, got {gamma!r}")
