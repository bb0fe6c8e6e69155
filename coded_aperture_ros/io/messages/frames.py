"""From the pixels of a message to frames in linear light, and back."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.imaging import Gamma, linear_from_pixels, pixels_from_linear
from coded_aperture_ros.io.messages.encodings import array_from_image, encoding_of

# Weights of linear red, green and blue in luminance (ITU-R BT.709).
_LUMINANCE = np.array([[0.2126, 0.7152, 0.0722]], np.float32)


def frame_from_image(message: Any, gamma: Gamma = 1.0) -> NDArray[np.float32]:
    """Return an image message as the frame that the library works on.

    See `array_from_image` and `frame_from_pixels`.
    """
    return frame_from_pixels(array_from_image(message), gamma)


def frame_from_pixels(pixels: NDArray, gamma: Gamma = 1.0) -> NDArray[np.float32]:
    """Return stored pixels as the frame that the library works on.

    Parameters
    ----------
    pixels : ndarray of uint8, uint16 or float, [row, column] or [row, column, RGB]
    gamma : float or "srgb"
        Turns 8-bit values into linear light; 1 for a linear sensor. 16-bit and
        float images are linear by definition.

    Returns
    -------
    float32, of the same shape
        Linear light; integers are scaled to [0, 1], floats are taken as they are.
    """
    if pixels.dtype == np.float32:
        return pixels
    if pixels.dtype == np.uint8 and gamma == 1.0:
        return pixels * np.float32(1 / 255)  # several times faster than a table
    return linear_from_pixels(pixels, gamma)


def luminance(frame: NDArray) -> NDArray:
    """Return the luminance of a linear frame of any type; a grey frame as it is."""
    if frame.ndim == 2:
        return frame
    return cv2.transform(frame, _LUMINANCE)


def pixels_from_frame(frame: NDArray, encoding: str, gamma: Gamma = 1.0) -> NDArray:
    """Return a frame as the pixels of an encoding: the inverse of `frame_from_image`.

    Parameters
    ----------
    frame : float32, [row, column] or [row, column, RGB]
        Linear light. Integer encodings clip it to [0, 1]; unknown (NaN) pixels become 0.
        Integers of the encoding's own type are kept as they are.
    encoding : str
        One of `ENCODINGS`; grey encodings of a colour frame hold its luminance.
    gamma : float or "srgb"

    Returns
    -------
    array, [row, column] or [row, column, stored channel]
    """
    target = encoding_of(encoding)
    if target.channels == 1:
        frame = luminance(frame)
    elif frame.ndim == 2:
        frame = cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_GRAY2RGB)
    if frame.dtype == target.dtype:
        pixels = frame
    elif target.dtype == "f4":
        pixels = linear_from_pixels(frame, gamma)
    else:
        linear = linear_from_pixels(frame, gamma)
        pixels = pixels_from_linear(linear, 8 * np.dtype(target.dtype).itemsize, gamma)
    return pixels if target.from_rgb is None else cv2.cvtColor(pixels, target.from_rgb)
