"""Decoding compressed pictures of unknown origin."""

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

_PNG_SIGNATURE, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND"
_JPEG_START, _JPEG_MARKER, _JPEG_TABLES, _JPEG_SHARE = b"\xff\xd8", 0xFF, 0xDB, 0.35
# As stored; turned upright as EXIF asks, a picture would no longer suit the mask.
AS_STORED = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


def decode_picture(data: bytes | memoryview, flags: int = AS_STORED) -> NDArray | None:
    """Return the pixels of a picture in any format that OpenCV reads; None of anything else.

    A PNG that is cut off, which OpenCV would decode in part without a word, is none either. `flags`
    are those of `cv2.imdecode`.
    """
    data = bytes(data)
    if not data or (data.startswith(_PNG_SIGNATURE) and not _is_whole_png(data)):
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None


def quantisation_sigma(data: bytes) -> float:
    """Return about how much noise JPEG has hidden in a picture: 0 where it is none.

    Standard deviation, of stored values from 0 to 1: a third of the rounding of the median
    luminance coefficient, which does best for depth from quality 95 down to 50.
    """
    start = 2
    if not data.startswith(_JPEG_START):
        return 0.0
    while start + 4 <= len(data) and data[start] == _JPEG_MARKER:
        kind, length = struct.unpack_from(">xBH", data, start)
        if kind == _JPEG_TABLES and not data[start + 4] & 15:  # that of the luminance
            wide = data[start + 4] >> 4
            steps = np.frombuffer(data, ">u2" if wide else np.uint8, 64, start + 5)
            return float(_JPEG_SHARE * np.median(steps) / 255 / np.sqrt(12))
        start += 2 + length
    return 0.0


def _is_whole_png(data: bytes) -> bool:
    """Return whether all chunks are there.

    OpenCV takes as much memory as a chunk says that it is long, up to four gigabytes.
    """
    start = len(_PNG_SIGNATURE)
    while start + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, start)
        start += 12 + length  # length, kind, content, checksum
        if kind == _PNG_END:
            return start <= len(data)
    return False
