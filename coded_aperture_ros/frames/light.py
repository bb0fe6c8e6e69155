"""Linear light: what a sensor counts, and what picture files and displays store instead."""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError

# An exponent (stored value = light ** (1 / gamma)), or the sRGB transfer curve.
Gamma = float | str
SRGB = "srgb"


def gamma_from_text(text: str) -> Gamma:
    """Read a gamma setting from a command line or parameter: a number or `srgb`.

    Raises `InputError` if it is neither.
    """
    if text.strip().lower() == SRGB:
        return SRGB
    try:
        gamma = float(text)
    except ValueError as error:
        raise InputError(f"gamma: expected a number or {SRGB}, got {text!r}") from error
    _check(gamma)
    return gamma


def decode(stored: ArrayLike, gamma: Gamma) -> FloatArray:
    """Turn stored values, 0 to 1, into linear light."""
    _check(gamma)
    values = np.asarray(stored, dtype=np.float32)
    if isinstance(gamma, str):
        curve = ((np.maximum(values, 0.0) + 0.055) / 1.055) ** 2.4
        return np.where(values <= 0.04045, values / 12.92, curve).astype(np.float32)
    return values if gamma == 1.0 else np.maximum(values, 0.0) ** np.float32(gamma)


def encode(light: ArrayLike, gamma: Gamma) -> FloatArray:
    """Turn linear light, 0 to 1, into stored values; the inverse of `decode`."""
    _check(gamma)
    values = np.asarray(light, dtype=np.float32)
    if isinstance(gamma, str):
        curve = 1.055 * np.maximum(values, 0.0) ** np.float32(1 / 2.4) - 0.055
        return np.where(values <= 0.0031308, values * 12.92, curve).astype(np.float32)
    return values if gamma == 1.0 else np.maximum(values, 0.0) ** np.float32(1.0 / gamma)


def compression_noise(lost: float, frame: FloatArray, gamma: Gamma) -> float:
    """Standard deviation of the noise that compression has hidden in a frame, linear light.

    Standard deviation; `lost` is what it has hidden of stored values from 0 to 1, 0 for nothing, of
    a frame [rows, columns(, channels)] that is linear light already. NaN counts as dark.
    """
    if not lost:
        return 0.0
    light = float(np.nan_to_num(frame[::8, ::8]).mean())
    stored = float(np.clip(encode(light, gamma), 0.05, 0.95))
    low, high = decode(np.array([stored - 0.01, stored + 0.01]), gamma)
    return float(lost * (high - low) / 0.02)


def linear_from_pixels(pixels: NDArray, gamma: Gamma = 1.0) -> FloatArray:
    """Turn pixels of any usual type into linear light.

    Integers (uint8, uint16) span 0 to their type's maximum; floats are taken as they are, NaN
    included. `gamma` says how 8-bit pixels are encoded; wider types are linear already. Raises
    `InputError` if the type is another one.
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


def pixels_from_linear(
    image: NDArray, bits: int, gamma: Gamma = 1.0
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Quantise linear light to 8 or 16 bits; clipped to 0..1, NaN becomes 0."""
    values = np.clip(image, 0.0, 1.0)
    unknown = np.isnan(values)
    if unknown.any():
        values[unknown] = 0.0
    stored = encode(values, gamma)
    if bits == 8 and stored.size:
        # Scales, rounds and converts in one go, to the same numbers.
        row = np.ascontiguousarray(stored).reshape(1, -1)
        return np.asarray(cv2.convertScaleAbs(row, alpha=255.0)).reshape(stored.shape)
    maximum, dtype = {8: (255.0, np.uint8), 16: (65535.0, np.uint16)}[bits]
    return np.rint(stored * np.float32(maximum)).astype(dtype)


def _check(gamma: Gamma) -> None:
    if gamma != SRGB and (isinstance(gamma, str) or not 0.1 <= gamma <= 10.0):
        raise InputError(f"gamma: expected 0.1 to 10 or {SRGB}, got {gamma!r}")
