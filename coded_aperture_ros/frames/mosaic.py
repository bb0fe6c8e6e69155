"""Frames as a sensor records them through a mosaic of red, green and blue filters (Bayer)."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError

# Filters of every square of two by two pixels, row by row.
MOSAICS = ("rggb", "bggr", "gbrg", "grbg")
# Colour varies this slowly (standard deviation of a Gaussian, px): what is faster is brightness.
# Chosen by depth: with 1.2 and 2 for both it is a tenth worse.
_GREEN_PX, _RED_BLUE_PX, _REACH_PX = 1.6, 1.2, 6
_SATURATED = 0.98


def grey_from_mosaic(mosaic: FloatArray, order: str) -> FloatArray:
    """Return the brightness, half green, of a frame behind a mosaic of colour filters.

    At full resolution, and with the noise of the pixels: in a mosaic's spectrum the brightness is
    around zero and colour around the highest frequencies, from where it is taken away (E. Dubois,
    "Frequency-domain methods for demosaicking of Bayer-sampled color images", IEEE Signal
    Processing Letters 12(12), 2005). So blurs are as sharp as on a grey sensor, which is not so
    with interpolated colours.

    The mosaic, float32 [rows, columns], is linear light in [0, 1]; `order`, such as "rggb", names
    the colours of the first two pixels of the first row and of the second. Where a pixel or one
    beside it is saturated, so is the result, of the same shape. Raises `InputError` if the frame is
    not grey, is smaller than 2x2 pixels, or the order is not one of the four.
    """
    grey, _, _ = _parts(mosaic, order)
    if mosaic.max() >= _SATURATED:
        brightest = cv2.dilate(mosaic, np.ones((3, 3), np.uint8))
        grey = np.where(brightest >= _SATURATED, brightest, grey)
    return grey


def colour_from_mosaic(mosaic: FloatArray, order: str) -> FloatArray:
    """Return the picture [rows, columns, RGB] of a frame behind a mosaic of colour filters.

    Of the brightness that `grey_from_mosaic` returns and its smooth colours; every pixel keeps the
    value of its own filter. Arguments and errors are the same.
    """
    grey, green, red_blue = _parts(mosaic, order)
    return np.dstack([grey + green + 2 * red_blue, grey - green, grey + green - 2 * red_blue])


def mosaic_from_colour(picture: FloatArray, order: str) -> FloatArray:
    """Return what a sensor records of a picture [rows, columns, RGB]: a value for each pixel."""
    mosaic = picture[..., 1].copy()
    for row, column, channel in _places(order):
        mosaic[row::2, column::2] = picture[row::2, column::2, channel]
    return mosaic


def _places(order: str) -> list[tuple[int, int, int]]:
    """Return row and column of red and blue in the square of a mosaic, and their channels."""
    if order not in MOSAICS:
        raise InputError(f"mosaic: {order!r} is no order of filters, use {', '.join(MOSAICS)}")
    return [(*divmod(order.index(letter), 2), channel) for letter, channel in (("r", 0), ("b", 2))]


def _parts(mosaic: FloatArray, order: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return brightness, and red and blue less green, and red less blue, a quarter of each."""
    if mosaic.ndim != 2 or min(mosaic.shape) < 2:
        raise InputError(f"mosaic: expected a grey frame of 2x2 pixels or more, got {mosaic.shape}")
    row, column, _ = _places(order)[0]
    # One where red is, and minus one beside it: colour is multiplied by these.
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
    kernel = cv2.getGaussianKernel(2 * _REACH_PX + 1, sigma_px)
    for every_other in (kernel[::2], kernel[1::2]):  # so that nothing passes that alternates
        every_other /= 2 * every_other.sum()
    # Reflected about the outermost pixels, which keeps the filters' places.
    return cv2.sepFilter2D(values, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
