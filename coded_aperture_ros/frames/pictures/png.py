"""PNG files: whether all of a picture is there."""

import struct
import zlib

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.input_file import check_picture_size

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER = b"IHDR"
_END = b"IEND"
# Animation, in which the picture is the first of several frames.
_ANIMATION = b"acTL"


def check_png(data: bytes) -> None:
    """Raise `InputError` if chunks are missing or damaged, or it is too large or has many frames.

    OpenCV decodes what there is, and allocates the length that a chunk declares, up to four
    gigabytes.
    """
    start = len(_SIGNATURE)
    view = memoryview(data)
    if data[start + 4 : start + 8] == _HEADER and len(data) >= start + 16:
        columns, rows = struct.unpack_from(">II", data, start + 8)
        check_picture_size(rows, columns)
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
