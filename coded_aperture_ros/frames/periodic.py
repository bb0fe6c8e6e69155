"""Images and PSFs with periodic borders, for Fourier transforms."""

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray, Shape, constant, zeros


def periodic_shape(shape: tuple[int, ...], extension_px: int) -> Shape:
    """Rows and columns, fast to transform, of an image extended by at least `extension_px`.

    Examples
    --------
    >>> periodic_shape((97, 120), 10)
    (108, 135)
    """
    rows, columns = (scipy.fft.next_fast_len(side + extension_px, real=True) for side in shape[:2])
    return rows, columns


def extend_periodically(image: FloatArray, shape: Shape) -> FloatArray:
    """Image extended below and to the right, with a smooth transition to its first row and column.

    A step between opposite borders would ring as far as filters reach: 7 dB near the border of a
    simulated room. Mirrored texture would not be blurred like the rest.

    Parameters
    ----------
    image : ndarray, float32 [rows, columns]
    shape : (int, int)
        Larger rows and columns; see `periodic_shape`.

    Returns
    -------
    ndarray, float32
        Of that shape.

    Examples
    --------
    >>> extend_periodically(np.float32([[0.0, 1.0]]), (1, 4)).round(2).tolist()
    [[0.0, 1.0, 0.75, 0.25]]
    """
    height, width = image.shape
    extended: FloatArray = zeros(shape, image)
    extended[:height, :width] = image
    across = constant(_smooth_ramp(shape[1] - width), image)
    down = constant(_smooth_ramp(shape[0] - height), image)
    first, last = image[:, :1], image[:, -1:]
    extended[:height, width:] = last + across * (first - last)
    first, last = extended[:1], extended[height - 1 : height]
    extended[height:] = last + down[:, None] * (first - last)
    return extended


def transfer_function(psf: FloatArray, shape: Shape) -> NDArray[np.complex64]:
    """Transfer function of a centred PSF for images of `shape`, laid out as by ``scipy.fft.rfft2``.

    Examples
    --------
    >>> transfer_function(np.ones((1, 1), np.float32), (4, 4)).shape
    (4, 3)
    """
    width = len(psf)
    padded = np.zeros(shape, np.float32)
    padded[:width, :width] = psf
    return scipy.fft.rfft2(np.roll(padded, (-(width // 2), -(width // 2)), axis=(0, 1)))


def _smooth_ramp(pixels: int) -> FloatArray:
    """Values from 0 to 1, without these ends [pixels]."""
    return (0.5 - 0.5 * np.cos(np.pi * np.arange(1, pixels + 1) / (pixels + 1))).astype(np.float32)
