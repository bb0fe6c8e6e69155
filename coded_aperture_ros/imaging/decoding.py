"""Decoding compressed pictures of unknown origin."""

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

_PNG_SIGNATURE, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND"
# As stored; turned upright as EXIF asks, a picture would no longer suit the mask.
AS_STORED = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


def decode_picture(data: bytes | memoryview, flags: int = AS_STORED) -> NDArray | None:
    """Return the pixels of a picture in any format that OpenCV reads; None of anything else.

    A PNG that is cut off, which OpenCV would decode in part without a word, is none either.

    Parameters
    ----------
    data : bytes-like
    flags : int, optional
        Of `cv2.imdecode`.
    """
    data = bytes(data)
    if not data or (data.startswith(_PNG_SIGNATURE) and not _is_whole_png(data)):
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None


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
