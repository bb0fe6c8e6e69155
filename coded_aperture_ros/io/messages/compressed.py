"""Images and depth as image_transport's plugins compress them: bytes, and the message's format."""

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.io.messages.encodings import MessageError, check_pixels

DEPTH_FORMATS = ("png", "rvl")
PICTURE_FORMATS = ("png", "jpeg")
# Before the depth: "inverse depth", and the two numbers that a value is turned into metres by.
_HEADER = struct.Struct("<i2f")
# Steps of inverse depth to a metre's: image_transport's own number, a tenth of a millimetre at 1 m.
_STEPS = 10_100.0
_MAX_VALUE = 65535
# Robots have little time and a fast network.
_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)
_JPEG_QUALITY = 95


def compressed_picture(
    pixels: NDArray, encoding: str, kind: str = "jpeg", quality: int = _JPEG_QUALITY
) -> tuple[bytes, str]:
    """Data and format of a picture in the transport `compressed`.

    Parameters
    ----------
    pixels : ndarray [rows, columns] or [rows, columns, channels]
        As one of `ENCODINGS` stores them.
    encoding : str
    kind : str
        ``png``, which keeps every pixel, or ``jpeg``, which 8 bits alone can have: 16 bits and
        mosaics, of which it would mix neighbouring colours, are PNG all the same.
    quality : int
        Of JPEG, 1 to 100.

    Raises
    ------
    MessageError
        Of kind "encoding", if the pixels have no compressed form: floats, and YUV.
    """
    target = check_pixels(pixels, encoding)
    if target.dtype == "f4" or target.channels == 2:
        raise MessageError("encoding", f"a picture of {encoding} cannot be compressed")
    if target.channels > 1:
        if target.to_rgb is not None:
            pixels = cv2.cvtColor(pixels, target.to_rgb)
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    deep = target.dtype == "u2"
    jpeg = kind == "jpeg" and not (deep or target.mosaic)
    kind = "jpeg" if jpeg else "png"
    settings = (cv2.IMWRITE_JPEG_QUALITY, quality) if jpeg else _PNG
    bits = 16 if deep else 8
    grey = f"mono{bits}" if deep and not target.mosaic else ""
    stored = f"bgr{bits}" if target.channels > 1 else grey
    data = cv2.imencode(f".{kind}", pixels, settings)[1].tobytes()
    return data, f"{encoding}; {kind} compressed {stored}"


def compressed_depth(depth: NDArray, kind: str = "png") -> tuple[bytes, str]:
    """Data and format of depth in the transport `compressedDepth`.

    The inverse of metres (float32) is kept in 16 bits, to 0.1 mm at 1 m and 10 mm at 10 m; +inf
    stays, NaN and -inf become unknown. Millimetres (uint16) are kept exactly. `kind` is png, or
    rvl, which keeps runs and differences (Wilson, Fast Lossless Depth Image Compression, 2017).
    """
    scale = 0.0
    values = depth
    if depth.dtype == np.float32:
        known = np.isfinite(depth) & (depth > 0)
        nearest = float(depth[known].min()) if known.any() else 1.0
        scale = min(_STEPS, (_MAX_VALUE - 1) * nearest)
        # 0 is unknown; a decoder divides by the value less 1.
        inverse = np.float32(scale) / np.where(known, depth, np.float32(np.inf)) + np.float32(1)
        kept = known | (depth == np.inf)
        values = np.where(kept, np.rint(inverse), 0).astype(np.uint16)
    header = _HEADER.pack(0, scale, 1.0 if scale else 0.0)
    if kind == "png":
        data = cv2.imencode(".png", values, _PNG)[1].tobytes()
    else:
        rows, columns = values.shape
        data = struct.pack("<2I", columns, rows) + _run_lengths(values.ravel())
    encoding = "32FC1" if depth.dtype == np.float32 else "16UC1"
    return header + data, f"{encoding}; compressedDepth {kind}"


def _run_lengths(values: NDArray[np.uint16]) -> bytes:
    """RVL: numbers of zeros, of others, and the others' differences, in groups of 3 bits."""
    filled = values != 0
    # Zeros, maybe none, then others, maybe none, and so on.
    changes = np.flatnonzero(np.diff(filled, prepend=False))
    ends = [len(values)] * (2 - len(changes) % 2)
    runs = np.diff(np.concatenate([[0], changes, ends]))
    others = values[filled].astype(np.int32)
    steps = np.diff(others, prepend=0)
    folded = (steps << 1) ^ (steps >> 31)
    # Both lengths of a pair stand before its differences.
    zeros = runs[::2]
    lengths = runs[1::2]
    starts = np.cumsum(lengths) - lengths
    tokens = np.insert(folded, np.repeat(starts, 2), np.column_stack([zeros, lengths]).ravel())
    return _groups(tokens.astype(np.uint32))


def _groups(tokens: NDArray[np.uint32]) -> bytes:
    """Numbers in groups of 3 bits, lowest first, with a fourth where more follow."""
    counts = np.ones(len(tokens), np.intp)
    for group in range(1, 8):
        counts += tokens >> np.uint32(3 * group) > 0
    first = np.cumsum(counts) - counts
    index = np.arange(counts.sum()) - np.repeat(first, counts)
    nibbles = (np.repeat(tokens, counts) >> (3 * index).astype(np.uint32)) & np.uint32(7)
    nibbles |= np.where(index < np.repeat(counts, counts) - 1, np.uint32(8), np.uint32(0))
    nibbles = np.pad(nibbles, (0, -len(nibbles) % 8)).reshape(-1, 8)
    words = nibbles @ (np.uint32(1) << np.arange(28, -1, -4, dtype=np.uint32))
    return words.astype("<u4").tobytes()
