"""What deblurring looks at in a frame: measured pixels, noise, brightness and colour."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.imaging import (
    PatchGrid,
    brightness_at,
    estimate_noise,
    filled,
    grey_image,
    high_power,
)

# One bad pixel beyond these bounds would spoil the whole frame through its Fourier transform.
_DARKEST, _BRIGHTEST = -1.0, 2.0
_NOISE_WINDOW_PX, _LEAST_SIDE_PX = 32, 8
# Orthonormal: noise that is alike and independent in red, green and blue stays so.
_OPPONENTS = np.array(
    [
        np.array([1.0, 1.0, 1.0]) / np.sqrt(3),
        np.array([1.0, 0.0, -1.0]) / np.sqrt(2),
        np.array([1.0, -2.0, 1.0]) / np.sqrt(6),
    ],
    np.float32,
)


def measured_pixels(
    frame: NDArray[np.float32], saturation: float
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return a frame whose impossible pixels are filled, and which pixels have been measured.

    Parameters
    ----------
    frame : ndarray, float32 [rows, columns] or [rows, columns, 3]
        Pixels that are not finite, or far from [0, 1], are impossible.
    saturation : float
        Brightness, at most 2, from which a pixel is not measured, but kept.

    Returns
    -------
    frame : ndarray, float32, like `frame`
        Finite.
    measured : ndarray, bool [rows, columns]
        In all channels.
    """
    # A NaN makes both comparisons false.
    measured = (frame > _DARKEST) & (frame < saturation)
    possible = measured if measured.all() else (frame > _DARKEST) & (frame < _BRIGHTEST)
    if not possible.all():
        channels = zip(np.atleast_3d(frame).T, np.atleast_3d(possible).T, strict=True)
        frame = np.stack(
            [filled(np.ascontiguousarray(channel), mask) for channel, mask in channels]
        ).T.reshape(frame.shape)
    if measured.ndim == 3:
        # Much faster than a reduction along so short an axis.
        measured = measured[..., 0] & measured[..., 1] & measured[..., 2]
    return np.ascontiguousarray(frame, np.float32), measured


def frame_noise(frame: NDArray[np.float32], noise: float, noise_gain: float) -> float:
    """Return the standard deviation of one channel's noise at the frame's mean brightness.

    Parameters
    ----------
    frame : ndarray, float32 [rows, columns] or [rows, columns, 3]
        Finite.
    noise : float
        Standard deviation without shot noise, as it is known; 0: estimated.
    noise_gain : float
        Variance of the shot noise per unit of light.

    Raises
    ------
    InputError
        If the frame is too small for its noise to be estimated.
    """
    grey, _ = grey_image(frame, np.inf)
    if not noise:
        height, width = grey.shape
        if min(height, width) < _LEAST_SIDE_PX:
            raise InputError(
                f"frame of {width}x{height} px is too small to estimate its noise, give the noise"
            )
        window = min(_NOISE_WINDOW_PX, 2 * (min(grey.shape) // 2))
        grid = PatchGrid.covering(grey.shape, window, window)
        channels = frame[0, 0].size
        shot = np.float32(noise_gain / channels) * np.maximum(brightness_at(grey, grid), 0)
        estimate = estimate_noise(high_power(grey, grid), shot if noise_gain else None)
        noise = estimate * float(np.sqrt(channels))
    return float(np.sqrt(noise**2 + noise_gain * max(float(grey.mean()), 0.0)))


def opponents(image: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Return brightness and two colour differences of an image; of a grey one just itself.

    Parameters
    ----------
    image : ndarray, float32 [rows, columns] or [rows, columns, 3]

    Returns
    -------
    list of ndarray, float32 [rows, columns]
        ``(r + g + b) / sqrt(3)``, ``(r - b) / sqrt(2)``, ``(r - 2 g + b) / sqrt(6)``.
    """
    if image.ndim == 2:
        return [image]
    return list(cv2.split(cv2.transform(image, _OPPONENTS)))


def from_opponents(channels: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Undo `opponents`."""
    if len(channels) == 1:
        return channels[0]
    return np.asarray(cv2.transform(cv2.merge(channels), _OPPONENTS.T), np.float32)
