"""Images and PSFs for Fourier transforms, to which the first row follows the last."""

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray, Shape


def periodic_shape(shape: tuple[int, ...], extension_px: int) -> Shape:
    """Return the rows and columns, fast to transform, of an image extended by so much at least."""
    rows, columns = (scipy.fft.next_fast_len(side + extension_px, real=True) for side in shape[:2])
    return rows, columns


def extend_periodically(image: FloatArray, shape: Shape) -> FloatArray:
    """Extend an image below and to the right, so that it goes on smoothly with its first row.

    The result, float32, is of a larger `shape` (rows, columns), see `periodic_shape`. A step
    between opposite borders would ring as far as filters reach: 7 dB near the border of a simulated
    room. Mirrored texture would not be blurred like the rest.
    """
    height, width = image.shape
    extended = np.empty(shape, np.float32)
    extended[:height, :width] = image
    across, down = _passage(shape[1] - width), _passage(shape[0] - height)
    first, last = image[:, :1], image[:, -1:]
    extended[:height, width:] = last + across * (first - last)
    first, last = extended[:1], extended[height - 1 : height]
    extended[height:] = last + down[:, None] * (first - last)
    return extended


def transfer_function(psf: FloatArray, shape: Shape) -> NDArray[np.complex64]:
    """Return the transform of a centred PSF for images of `shape`, as by ``scipy.fft.rfft2``."""
    width = len(psf)
    padded = np.zeros(shape, np.float32)
    padded[:width, :width] = psf
    return scipy.fft.rfft2(np.roll(padded, (-(width // 2), -(width // 2)), axis=(0, 1)))


def _passage(pixels: int) -> FloatArray:
    """Return the steps of a smooth way from 0 to 1, without its ends."""
    return (0.5 - 0.5 * np.cos(np.pi * np.arange(1, pixels + 1) / (pixels + 1))).astype(np.float32)
