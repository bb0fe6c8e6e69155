"""Pixel encodings of `sensor_msgs/Image` and `sensor_msgs/CompressedImage`."""

import re
import sys
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import MOSAICS, decode_picture

_COMPRESSED_FORMATS = ("JPEG", "PNG")
_GREY_INTEGERS = ("mono8", "8UC1", "mono16", "16UC1")
# What the format of a compressed mosaic begins with, or names somewhere.
_MOSAIC_FORMAT = re.compile(rf"bayer_?({'|'.join(MOSAICS)})", re.IGNORECASE)


class MessageError(InputError):
    """Message that cannot be used; `kind` names the fault in one word, for counting."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        """Both arguments: pools of processes send exceptions to each other."""
        return type(self), (self.kind, str(self))


@dataclass(frozen=True)
class Encoding:
    """Storage of a pixel in one `sensor_msgs/Image` encoding."""

    dtype: str
    channels: int
    to_rgb: int | None = None  # OpenCV's colour conversions; None where there is nothing to do
    from_rgb: int | None = None
    mosaic: str = ""  # of colour filters, if pixels have one each; see `grey_from_mosaic`


ENCODINGS = {
    "mono8": Encoding("u1", 1),
    "8UC1": Encoding("u1", 1),
    "mono16": Encoding("u2", 1),
    "16UC1": Encoding("u2", 1),
    "32FC1": Encoding("f4", 1),
    "rgb8": Encoding("u1", 3),
    "bgr8": Encoding("u1", 3, cv2.COLOR_BGR2RGB, cv2.COLOR_RGB2BGR),
    "rgb16": Encoding("u2", 3),
    "bgr16": Encoding("u2", 3, cv2.COLOR_BGR2RGB, cv2.COLOR_RGB2BGR),
    "rgba8": Encoding("u1", 4, cv2.COLOR_RGBA2RGB, cv2.COLOR_RGB2RGBA),
    "bgra8": Encoding("u1", 4, cv2.COLOR_BGRA2RGB, cv2.COLOR_RGB2BGRA),
    "yuv422": Encoding("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": Encoding("u1", 2, cv2.COLOR_YUV2RGB_YUYV),
} | {
    f"bayer_{order}{8 * size}": Encoding(f"u{size}", 1, mosaic=order)
    for size in (1, 2)
    for order in MOSAICS
}


def parse_encoding(name: str) -> Encoding:
    """Encoding of a name; raises `MessageError` of kind "encoding" if it is not supported."""
    if name not in ENCODINGS:
        known = ", ".join(ENCODINGS)
        raise MessageError("encoding", f"image encoding {name!r} is not supported, use {known}")
    return ENCODINGS[name]


def output_encoding(name: str) -> str:
    """Encoding for the result of an image: its own, or RGB for YUV and Bayer."""
    encoding = parse_encoding(name)
    if encoding.channels != 2 and not encoding.mosaic:
        return name
    return "rgb16" if encoding.dtype == "u2" else "rgb8"


def mosaic_encoding(name: str, order: str) -> str:
    """Encoding of images that a driver calls grey, but which are a mosaic of colour filters.

    Parameters
    ----------
    name : str
        Encoding that the message has; others than grey integers stay as they are.
    order : str
        Of the filters, one of `MOSAICS`; empty: the pixels are grey.

    Examples
    --------
    >>> mosaic_encoding("mono16", "rggb"), mosaic_encoding("bgr8", "rggb")
    ('bayer_rggb16', 'bgr8')
    """
    if not order or name not in _GREY_INTEGERS:
        return name
    return f"bayer_{order}{8 * np.dtype(ENCODINGS[name].dtype).itemsize}"


def stamp_ns(header: Any) -> int:
    """Stamp of a header, ns."""
    return int(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)


def array_from_image(message: Any) -> NDArray:
    """Pixels of an image message as they are stored, in native byte order.

    The message is a `sensor_msgs/Image` of rclpy, of a bag, or anything with the same fields, in
    one of `ENCODINGS`. Rows may be padded (`step`) and bytes swapped (`is_bigendian`). The result
    is [row, column] or [row, column, RGB], of the stored dtype, without alpha; a mosaic of colour
    filters stays unchanged. It may be a view of the message's data: do not write to it. Raises
    `MessageError` of kind "encoding", "size", "step" or "data".
    """
    encoding = parse_encoding(message.encoding)
    height = message.height
    width = message.width
    step = message.step
    if height == 0 or width == 0:
        raise MessageError("size", f"the image is empty ({width}x{height})")
    row_bytes = width * np.dtype(encoding.dtype).itemsize * encoding.channels
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
    if encoding.channels == 2 and width % 2:
        raise MessageError("size", f"{message.encoding} has pixels in pairs, not {width} in a row")
    pixels = pixels.reshape(height, width, encoding.channels)
    return pixels if encoding.to_rgb is None else cv2.cvtColor(pixels, encoding.to_rgb)


def array_from_compressed(message: Any) -> tuple[NDArray, str]:
    """Pixels of a compressed image message, and their encoding.

    The message is a `sensor_msgs/CompressedImage` or anything with its fields. It holds JPEG or
    PNG: whoever sends a message must not choose among all decoders. Pixels are uint8 or uint16,
    [row, column] or [row, column, RGB].

    Their encoding is mono8, mono16, rgb8 or rgb16; or, where grey pixels are a mosaic of colour
    filters, that which `format` names, as image_transport has it: `bayer_rggb8; png compressed`.

    Raises `MessageError` of kind "encoding" for the compressed depth of image_transport, or "data".
    """
    if "compressedDepth" in message.format:
        raise MessageError(
            "encoding", f"format {message.format!r} is compressed depth, expected a picture"
        )
    try:
        pixels = decode_picture(message.data, _COMPRESSED_FORMATS).pixels
    except InputError as error:
        what = f"{len(message.data)} bytes of {message.format!r} cannot be read: {error}"
        raise MessageError("data", what) from error
    if pixels.dtype not in (np.uint8, np.uint16):
        raise MessageError("encoding", f"compressed pixels of {pixels.dtype} are not supported")
    bits = 8 * pixels.dtype.itemsize
    if pixels.ndim == 2:
        mosaic = _MOSAIC_FORMAT.search(message.format)
        return pixels, f"bayer_{mosaic[1].lower()}{bits}" if mosaic else f"mono{bits}"
    # image_transport stores pictures in the usual way, whatever encoding they had before.
    return pixels, f"rgb{bits}"


def check_pixels(pixels: NDArray, encoding: str) -> Encoding:
    """Encoding of a name, after a check that pixels are exactly as it stores them.

    Pixels are [row, column(, stored channel)]. Fields of motion, right and down, are stored as
    optical flow is: 32FC2. Raises `MessageError` of kind "encoding" if they are of another type or
    number of channels.
    """
    target = Encoding("f4", 2) if encoding == "32FC2" else parse_encoding(encoding)
    shape = (*pixels.shape[:2], *((target.channels,) if target.channels > 1 else ()))
    if pixels.dtype != np.dtype(target.dtype) or pixels.shape != shape or pixels.ndim < 2:
        raise MessageError(
            "encoding",
            f"{encoding} needs {np.dtype(target.dtype)} with {target.channels} channel(s), "
            f"got {pixels.dtype} {pixels.shape}",
        )
    return target
