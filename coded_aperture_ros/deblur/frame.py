"""What deblurring looks at in a frame: measured pixels, brightness and colour."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.imaging import filled

# One bad pixel beyond these bounds would spoil the whole frame through its Fourier transform.
_DARKEST, _BRIGHTEST = -1.0, 2.0
# Orthonormal: noise that is alike and independent in red, green and blue stays so.
_OPPONENTS = np.float32(np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]]))


def measured_pixels(
    frame: NDArray[np.float32], saturation: float
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return a frame whose impossible pixels are filled, and which pixels have been measured.

    Pixels that are not finite, or far from [0, 1], are impossible. From a brightness of
    `saturation` on, at most 2, they are kept, but have not been measured. What has been measured
    [rows, columns] is so in all channels.
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


def opponents(image: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Return brightness and two colour differences of an image; of a grey one just itself.

    They are ``(r + g + b) / sqrt(3)``, ``(r - b) / sqrt(2)``, ``(r - 2 g + b) / sqrt(6)``.
    """
    if image.ndim == 2:
        return [image]
    return list(cv2.split(cv2.transform(image, _OPPONENTS)))


def from_opponents(channels: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Undo `opponents`."""
    if len(channels) == 1:
        return channels[0]
    return np.asarray(cv2.transform(cv2.merge(channels), _OPPONENTS.T), np.float32)
