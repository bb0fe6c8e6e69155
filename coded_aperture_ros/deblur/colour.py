"""Colour as one brightness and two differences that share their edges."""

import cv2
import numpy as np
from numpy.typing import NDArray

# Orthonormal: noise that is alike and independent in red, green and blue stays so.
_OPPONENTS = np.array(
    [
        np.array([1.0, 1.0, 1.0]) / np.sqrt(3),
        np.array([1.0, 0.0, -1.0]) / np.sqrt(2),
        np.array([1.0, -2.0, 1.0]) / np.sqrt(6),
    ],
    np.float32,
)


def opponents(image: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Return brightness and colour differences of an image; of a grey one just itself.

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
