"""Frames of sensors with a mosaic of red, green and blue filters (Bayer)."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError

# Filters of every square of two by two pixels, row by row.
MOSAICS = ("rggb", "bggr", "gbrg", "grbg")
# Low-pass filters of colour, standard deviation of a Gaussian, px: faster changes are brightness.
# Chosen by depth: with 1.2 and 2 for both it is a tenth worse.
_GREEN_PX = 1.6
_RED_BLUE_PX = 1.2
# Half the width of their kernels, px.
_REACH_PX = 6
_SATURATED = 0.98


def grey_from_mosaic(mosaic: FloatArray, order: str) -> FloatArray:
    """Brightness, half green, of a frame behind a mosaic of colour filters.

    It has full resolution and the noise of the pixels: in a mosaic's spectrum the brightness is
    around zero and colour around the highest frequencies, which are filtered out. So blur is as
    sharp as on a grey sensor, unlike that of interpolated colours.

    Parameters
    ----------
    mosaic : ndarray, float32 [rows, columns]
        Linear light in [0, 1].
    order : {"rggb", "bggr", "gbrg", "grbg"}
        Colours of the first two pixels of the first row and of the second.

    Returns
    -------
    ndarray, float32 [rows, columns]
        Saturated where a pixel or one beside it is.

    Raises
    ------
    InputError
        If the frame is not grey, is smaller than 2x2 pixels, or the order is another one.

    References
    ----------
    E. Dubois, "Frequency-domain methods for demosaicking of Bayer-sampled color images", IEEE
    Signal Processing Letters 12(12), 2005.

    Examples
    --------
    >>> float(grey_from_mosaic(np.full((16, 16), 0.5, np.float32), "rggb")[8, 8].round(3))
    0.5
    """
    grey, _, _ = _split(mosaic, order)
    if mosaic.max() >= _SATURATED:
        brightest = cv2.dilate(mosaic, np.ones((3, 3), np.uint8))
        grey = np.where(brightest >= _SATURATED, brightest, grey)
    return grey


def colour_from_mosaic(mosaic: FloatArray, order: str) -> FloatArray:
    """Colour picture [rows, columns, RGB] of a frame behind a mosaic of colour filters.

    Its brightness is that of `grey_from_mosaic`, its colours are smooth, and every pixel keeps the
    value of its own filter.

    Parameters
    ----------
    mosaic, order
        See `grey_from_mosaic`.

    Raises
    ------
    InputError
        See `grey_from_mosaic`.

    Examples
    --------
    >>> colour_from_mosaic(np.full((16, 16), 0.5, np.float32), "rggb").shape
    (16, 16, 3)
    """
    grey, green, red_blue = _split(mosaic, order)
    return np.dstack([grey + green + 2 * red_blue, grey - green, grey + green - 2 * red_blue])


def mosaic_from_colour(picture: FloatArray, order: str) -> FloatArray:
    """Mosaic [rows, columns] that a sensor records of a picture [rows, columns, RGB].

    Examples
    --------
    >>> picture = np.ones((2, 2, 3), np.float32) * np.float32([1, 2, 3])
    >>> mosaic_from_colour(picture, "rggb").tolist()
    [[1.0, 2.0], [2.0, 3.0]]
    """
    mosaic = picture[..., 1].copy()
    for row, column, channel in _red_and_blue_positions(order):
        mosaic[row::2, column::2] = picture[row::2, column::2, channel]
    return mosaic


def _red_and_blue_positions(order: str) -> list[tuple[int, int, int]]:
    """Row and column of red and blue in the square of a mosaic, and their channels."""
    if order not in MOSAICS:
        raise InputError(f"mosaic: {order!r} is no order of filters, use {', '.join(MOSAICS)}")
    return [(*divmod(order.index(letter), 2), channel) for letter, channel in (("r", 0), ("b", 2))]


def _split(mosaic: FloatArray, order: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Brightness, a quarter of red and blue less green, and a quarter of red less blue."""
    if mosaic.ndim != 2 or min(mosaic.shape) < 2:
        raise InputError(f"mosaic: expected a grey frame of 2x2 pixels or more, got {mosaic.shape}")
    row, column, _ = _red_and_blue_positions(order)[0]
    # Carriers of colour: 1 in the rows and columns of red, -1 beside them.
    down, across = (
        np.where((np.arange(length) - start) % 2, np.float32(-1), np.float32(1))
        for length, start in zip(mosaic.shape, (row, column), strict=True)
    )
    both = np.asarray(np.multiply.outer(down, across), np.float32)
    one = np.asarray(np.add.outer(down, across), np.float32)
    green = _smooth(mosaic * both, _GREEN_PX)
    red_blue = _smooth(mosaic * one * np.float32(0.5), _RED_BLUE_PX)
    return mosaic - green * both - red_blue * one, green, red_blue


def _smooth(values: FloatArray, sigma_px: float) -> FloatArray:
    """Low-pass filtered values, without what alternates from pixel to pixel."""
    kernel = cv2.getGaussianKernel(2 * _REACH_PX + 1, sigma_px)
    for every_other in (kernel[::2], kernel[1::2]):  # equal sums remove what alternates
        every_other /= 2 * every_other.sum()
    # Reflected about the outermost pixels, which keeps the order of the filters.
    return cv2.sepFilter2D(values, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
