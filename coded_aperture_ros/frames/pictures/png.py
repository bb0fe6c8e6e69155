"""PNG files: whether all of a picture is there."""

import struct
import zlib

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.input_file import check_picture_size

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER = b"IHDR"
_END = b"IEND"
_HEADER_BYTES = 13
# Bits of a sample that go with each type of colour.
_BITS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
# Animation, in which the picture is the first of several frames.
_ANIMATION = b"acTL"


def check_png(data: bytes) -> None:
    """Raise `InputError` if chunks are missing or damaged, or it is too large or has many frames.

    OpenCV decodes what there is, and allocates the length that a chunk declares, up to four
    gigabytes.
    """
    start = len(_SIGNATURE)
    view = memoryview(data)
    _check_header(data[start : start + 8 + _HEADER_BYTES])
    while start + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, start)
        end = start + 12 + length  # length, kind, content, checksum
        if end > len(data):
            break
        if zlib.crc32(view[start + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise InputError("damaged: a checksum of the PNG is wrong")
        if kind == _ANIMATION:
            raise InputError("PNG of several frames, expected one: write each into its own file")
        if kind == _END:
            return
        start = end
    raise InputError("not a picture, or truncated")


def _check_header(chunk: bytes) -> None:
    """Raise `InputError` unless this is the header of a picture that is not too large.

    libpng prints lines of its own about it.
    """
    if len(chunk) < 8 + _HEADER_BYTES:
        raise InputError("not a picture, or truncated")
    length, kind, columns, rows, bits, colour, *methods = struct.unpack(">I4sIIBBBBB", chunk)
    is_known = bits in _BITS.get(colour, ()) and methods in ([0, 0, 0], [0, 0, 1])
    if length != _HEADER_BYTES or kind != _HEADER or not (columns and rows and is_known):
        raise InputError("damaged: the header of the PNG is none")
    check_picture_size(rows, columns)
