"""Decoding compressed pictures, whole or damaged."""

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND"
_JPEG_START = b"\xff\xd8"
_JPEG_MARKER = 0xFF
_JPEG_TABLES = 0xDB
# Noise over the rounding of the median coefficient: best for depth from quality 95 down to 50.
_JPEG_SHARE = 0.35
# Without EXIF's rotation: a rotated picture would not match the mask.
AS_STORED = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


def decode_picture(data: bytes | memoryview, flags: int = AS_STORED) -> NDArray | None:
    """Pixels of a picture in any format that OpenCV reads; None if it cannot be decoded.

    Parameters
    ----------
    data : bytes
        A truncated PNG, which OpenCV decodes in part without an error, is not decoded.
    flags : int
        Flags of `cv2.imdecode`.

    Examples
    --------
    >>> picture = cv2.imencode(".png", np.zeros((4, 6), np.uint8))[1].tobytes()
    >>> decode_picture(picture).shape
    (4, 6)
    >>> decode_picture(picture[:-8]) is None
    True
    """
    data = bytes(data)
    if not data or (data.startswith(_PNG_SIGNATURE) and not _is_whole_png(data)):
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None


def quantisation_sigma(data: bytes) -> float:
    """Standard deviation of JPEG's quantisation, of stored values in [0, 1]; 0 without JPEG.

    It is a third of the rounding of the median luminance coefficient.
    """
    start = 2
    if not data.startswith(_JPEG_START):
        return 0.0
    while start + 4 <= len(data) and data[start] == _JPEG_MARKER:
        kind, length = struct.unpack_from(">xBH", data, start)
        if kind == _JPEG_TABLES and not data[start + 4] & 15:  # table of the luminance
            wide = data[start + 4] >> 4
            steps = np.frombuffer(data, ">u2" if wide else np.uint8, 64, start + 5)
            return float(_JPEG_SHARE * np.median(steps) / 255 / np.sqrt(12))
        start += 2 + length
    return 0.0


def _is_whole_png(data: bytes) -> bool:
    """Whether all chunks are there.

    OpenCV allocates the length that a chunk declares, up to four gigabytes.
    """
    start = len(_PNG_SIGNATURE)
    while start + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, start)
        start += 12 + length  # length, kind, content, checksum
        if kind == _PNG_END:
            return start <= len(data)
    return False
