"""From messages to frames in linear light and depth, and back (REP 117, 118)."""

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.frames import (
    Frame,
    Gamma,
    PixelFormat,
    linear_from_pixels,
    mosaic_from_colour,
    pixels_from_linear,
)
from coded_aperture_ros.io.messages.encodings import MessageError, array_from_image, parse_encoding

# Weights of linear red, green and blue in luminance (ITU-R BT.709).
_LUMINANCE = np.array([[0.2126, 0.7152, 0.0722]], np.float32)
# Relative error of a depth computed from a blur size in single precision, generously.
_DEPTH_ROUNDING = 1e-4
_MILLIMETRE = np.float32(1e-3)


def frame_from_image(
    message: Any,
    pixel_format: PixelFormat | None = None,
    compression_loss: float = 0.0,
    *,
    colour: bool = False,
    **known: Any,
) -> Frame:
    """Frame of an image message.

    Parameters
    ----------
    message : sensor_msgs/Image
        Its encoding says whether there is a mosaic.
    pixel_format : PixelFormat, optional
        How pixels become linear light.
    compression_loss : float
        See `PixelFormat.frame`.
    colour : bool
        Whether a mosaic is turned into a colour picture, too, which takes time.
    **known
        Other attributes of the `Frame`.

    Raises
    ------
    MessageError
        If the message cannot be read; see `array_from_image`.
    """
    mosaic = parse_encoding(message.encoding).mosaic
    pixel_format = dataclasses.replace(pixel_format or PixelFormat(), mosaic=mosaic)
    pixels = array_from_image(message)
    return pixel_format.frame(pixels, compression_loss, colour=colour, **known)


def luminance(frame: NDArray) -> NDArray:
    """Luminance of a linear frame of any type; a grey frame unchanged."""
    if frame.ndim == 2:
        return frame
    return cv2.transform(frame, _LUMINANCE)


def pixels_from_frame(frame: NDArray, encoding: str, gamma: Gamma = 1.0) -> NDArray:
    """Pixels of an encoding for a frame: the inverse of `frame_from_image`.

    The frame, float32 [row, column] or [row, column, RGB], is linear light. Integer encodings clip
    it to [0, 1]; unknown (NaN) pixels become 0. Integers of the encoding's own type stay unchanged.
    `encoding` is one of `ENCODINGS`; grey ones of a colour frame hold its luminance, mosaics the
    light of each pixel's filter. The result is [row, column] or [row, column, stored channel].
    """
    target = parse_encoding(encoding)
    if target.mosaic and frame.ndim == 3:
        frame = mosaic_from_colour(frame, target.mosaic)
    elif target.channels == 1:
        frame = luminance(frame)
    elif frame.ndim == 2:
        frame = cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_GRAY2RGB)
    if frame.dtype == target.dtype:
        pixels = frame
    elif target.dtype == "f4":
        pixels = linear_from_pixels(frame, gamma)
    else:
        linear = linear_from_pixels(frame, gamma)
        deep = target.dtype == "u2"
        pixels = pixels_from_linear(linear, 16 if deep else 8, 1.0 if deep else gamma)
    return pixels if target.from_rgb is None else cv2.cvtColor(pixels, target.from_rgb)


def limit_depth(depth_m: FloatArray, near_m: float = 0.0, far_m: float = np.inf) -> FloatArray:
    """Depth map in m, float32 [row, column], with depths outside the range marked as in REP 117.

    -Inf where nearer than `near_m`, +Inf where farther than `far_m`, NaN where the depth is
    unknown: unknown is never called far. It is the map itself where nothing is to be marked.
    """
    limited_m = depth_m.astype(np.float32, copy=False)
    # The outermost levels of a bank are the ends of the range but for rounding.
    for outside, marked in (
        (limited_m < near_m * (1 - _DEPTH_ROUNDING), np.float32(-np.inf)),
        (limited_m > far_m * (1 + _DEPTH_ROUNDING), np.float32(np.inf)),
    ):
        # Most often nothing is: finding that out takes a twentieth of the time of marking.
        if outside.any():
            limited_m = np.where(outside, marked, limited_m)
    return limited_m


def limit_layer(
    values: FloatArray, kind: str, near_m: float = 0.0, far_m: float = np.inf
) -> FloatArray:
    """Values of a layer of a kind, see `LayerSpec`, as they are published for a range of depths."""
    if kind == "depth":
        return limit_depth(values, near_m, far_m)
    return np.minimum(values, np.float32(far_m)) if kind == "bound" else values


def millimetres_from_depth(depth_m: FloatArray) -> NDArray[np.uint16]:
    """Depth in whole millimetres, uint16, as REP 118 stores it in 16UC1.

    0 stands for everything without a distance: unknown, too near, beyond the range. A distance too
    long for 16 bits saturates at 65535 instead of wrapping, and one below half a millimetre becomes
    1, because 0 is taken.
    """
    known = np.isfinite(depth_m) & (depth_m > 0)
    # Clipped in metres first: the largest float32 would overflow when multiplied.
    millimetres = np.rint(np.clip(np.where(known, depth_m, 0.0), 0.0, 66.0) * 1000.0)
    return np.where(known, np.clip(millimetres, 1, 65535), 0).astype(np.uint16)


def depth_pixels(message: Any) -> NDArray:
    """Pixels of a depth image (REP 118); raises `MessageError` ("depth") if it is none."""
    pixels = array_from_image(message)
    if message.encoding not in ("32FC1", "16UC1", "mono16"):
        raise MessageError("depth", f"depth image is {message.encoding}, expected 32FC1 or 16UC1")
    return pixels


def depth_from_pixels(pixels: NDArray) -> FloatArray:
    """Depth in m, float32, of another camera's depth image, float32 (m) or uint16 (mm).

    NaN where the message has no distance: 0, negative, NaN, infinite.
    """
    depth_m = pixels * _MILLIMETRE if pixels.dtype == np.uint16 else pixels
    known = np.isfinite(depth_m) & (depth_m > 0)
    return np.where(known, depth_m, np.float32(np.nan)).astype(np.float32)
