"""How `sensor_msgs/Image` stores pixels, for messages of any library.

Nothing here needs ROS: a message is whatever has the fields of its type.
"""

import sys
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError


class MessageError(InputError):
    """A message that cannot be used; `kind` names the fault in one word, for counting."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


@dataclass(frozen=True)
class Encoding:
    """How one `sensor_msgs/Image` encoding stores a pixel."""

    dtype: str
    channels: int
    to_rgb: int | None = None  # OpenCV's colour conversions; None where there is nothing to do
    from_rgb: int | None = None

    @property
    def pixel_bytes(self) -> int:
        """Return the bytes of one pixel."""
        return np.dtype(self.dtype).itemsize * self.channels


ENCODINGS = {
    "mono8": Encoding("u1", 1),
    "8UC1": Encoding("u1", 1),
    "mono16": Encoding("u2", 1),
    "16UC1": Encoding("u2", 1),
    "32FC1": Encoding("f4", 1),
    "rgb8": Encoding("u1", 3),
    "bgr8": Encoding("u1", 3, cv2.COLOR_BGR2RGB, cv2.COLOR_RGB2BGR),
    "rgba8": Encoding("u1", 4, cv2.COLOR_RGBA2RGB, cv2.COLOR_RGB2RGBA),
    "bgra8": Encoding("u1", 4, cv2.COLOR_BGRA2RGB, cv2.COLOR_RGB2BGRA),
}


def encoding_of(name: str) -> Encoding:
    """Return the `Encoding` called `name`; a `MessageError` of kind "encoding" if unsupported."""
    try:
        return ENCODINGS[name]
    except KeyError:
        raise MessageError(
            "encoding", f"image encoding {name!r} is not supported, use {', '.join(ENCODINGS)}"
        ) from None


def array_from_image(message: Any) -> NDArray:
    """Return the pixels of an image message as they are stored, in native byte order.

    Parameters
    ----------
    message : sensor_msgs/Image
        Of rclpy, of a bag, or anything with the same fields. In one of `ENCODINGS`. Rows may be
        padded (`step`) and bytes swapped (`is_bigendian`).

    Returns
    -------
    array, [row, column] or [row, column, RGB]
        dtype as stored. Channels are in the order red, green, blue; alpha is left out. It may be
        a view of the message's data: do not write to it.

    Raises
    ------
    MessageError
        Of kind "encoding", "size", "step" or "data".
    """
    encoding = encoding_of(message.encoding)
    height, width, step = message.height, message.width, message.step
    if height == 0 or width == 0:
        raise MessageError("size", f"the image is empty ({width}x{height})")
    row_bytes = width * encoding.pixel_bytes
    if step < row_bytes:
        raise MessageError(
            "step", f"step is {step} bytes, {width} pixels of {message.encoding} need {row_bytes}"
        )
    if len(message.data) < step * height:
        raise MessageError(
            "data", f"image data has {len(message.data)} bytes, {height} rows need {step * height}"
        )
    rows = np.frombuffer(message.data, np.uint8, step * height).reshape(height, step)
    pixels = np.ascontiguousarray(rows[:, :row_bytes]).view(encoding.dtype)
    swapped = bool(message.is_bigendian) != (sys.byteorder == "big")
    if swapped and pixels.dtype.itemsize > 1:
        pixels = pixels.byteswap()
    if encoding.channels == 1:
        return pixels
    pixels = pixels.reshape(height, width, encoding.channels)
    return pixels if encoding.to_rgb is None else cv2.cvtColor(pixels, encoding.to_rgb)


def check_pixels(pixels: NDArray, encoding: str) -> Encoding:
    """Check that pixels are exactly as an encoding stores them, and return that.

    Parameters
    ----------
    pixels : array, [row, column] or [row, column, stored channel]
    encoding : str
        One of `ENCODINGS`.

    Raises
    ------
    MessageError
        Of kind "encoding", if they are of another type or number of channels.
    """
    target = encoding_of(encoding)
    shape = (*pixels.shape[:2], *((target.channels,) if target.channels > 1 else ()))
    if pixels.dtype != np.dtype(target.dtype) or pixels.shape != shape or pixels.ndim < 2:
        raise MessageError(
            "encoding",
            f"{encoding} needs {np.dtype(target.dtype)} with {target.channels} channel(s), "
            f"got {pixels.dtype} {pixels.shape}",
        )
    return target
