"""Formats by the first bytes of a file, and the size of BMP and WebP pictures."""

import struct

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.input_file import check_picture_size

# Formats that OpenCV can decode in some builds, but which no camera of ours writes.
_REFUSED = (
    (0, b"GIF8", "GIF"),
    (0, b"#?RADIANCE", "Radiance HDR"),
    (0, b"#?RGBE", "Radiance HDR"),
    (0, b"v/1\x01", "OpenEXR"),
    (0, b"\0\0\0\x0cjP  ", "JPEG 2000"),
    (0, b"\xff\x4f\xff\x51", "JPEG 2000"),
    (0, b"\x59\xa6\x6a\x95", "Sun raster"),
    (4, b"ftyp", "AVIF or HEIF"),
    (0, b"\xff\x0a", "JPEG XL"),
    (0, b"\0\0\0\x0cJXL ", "JPEG XL"),
)
_OS2_HEADER_BYTES = 12


def refused_format(data: bytes) -> str:
    """Name of a known format that is not read; empty if it is none of them."""
    return next((name for at, magic, name in _REFUSED if data.startswith(magic, at)), "")


def check_bmp(data: bytes) -> None:
    """Raise `InputError` if a BMP is too large, or its header is cut off."""
    try:
        (header,) = struct.unpack_from("<I", data, 14)
        layout = "<hh" if header == _OS2_HEADER_BYTES else "<ii"
        columns, rows = struct.unpack_from(layout, data, 18)
    except struct.error as error:
        raise InputError("not a picture, or truncated") from error
    # Rows are negative where the first one is the top.
    check_picture_size(abs(rows), abs(columns))


def check_webp(data: bytes) -> None:
    """Raise `InputError` if a WebP is an animation or too large, or its header is cut off."""
    if data.find(b"ANIM", 12, 64) >= 0:
        raise InputError("an animation, expected one picture: write each frame into a file")
    kind = data[12:16]
    try:
        if kind == b"VP8X":
            (wide, high) = (int.from_bytes(data[at : at + 3], "little") for at in (24, 27))
            check_picture_size(high + 1, wide + 1)
        elif kind == b"VP8L":
            (bits,) = struct.unpack_from("<I", data, 21)
            check_picture_size((bits >> 14 & 0x3FFF) + 1, (bits & 0x3FFF) + 1)
        elif kind == b"VP8 ":
            columns, rows = struct.unpack_from("<HH", data, 26)
            check_picture_size(rows & 0x3FFF, columns & 0x3FFF)
        else:
            raise InputError("not a picture, or truncated")
    except struct.error as error:
        raise InputError("not a picture, or truncated") from error
