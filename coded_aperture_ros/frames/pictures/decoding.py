"""Pixels of picture files and compressed messages, as the sensor's rows and columns stored them."""

import dataclasses
import re
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames.pictures.jpeg import check_jpeg, is_damaged_jpeg, quantisation_sigma
from coded_aperture_ros.frames.pictures.other_formats import check_bmp, check_webp, refused_format
from coded_aperture_ros.frames.pictures.png import check_png
from coded_aperture_ros.frames.pictures.pnm import read_pnm
from coded_aperture_ros.frames.pictures.tiff import readable_tiff

# Without EXIF's rotation: a rotated picture would not match the mask.
_AS_STORED = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
_NO_PICTURE = "not a picture, or truncated"
# How files of the formats begin that are read. OpenCV knows more, and chooses for itself.
_FIRST_BYTES = {
    "JPEG": rb"\xff\xd8\xff",
    "PNG": rb"\x89PNG\r\n\x1a\n",
    "TIFF": rb"II[*+]\0|MM\0[*+]",
    "Netpbm": rb"P[1-7fF][\s#]",
    "BMP": rb"BM",
    "WebP": rb"RIFF.{4}WEBP",
}
FORMATS = tuple(_FIRST_BYTES)


@dataclasses.dataclass(frozen=True, eq=False)
class StoredPicture:
    """Picture as its file stores it.

    Attributes
    ----------
    pixels : ndarray, uint8, uint16 or float [rows, columns] or [rows, columns, RGB]
        In native byte order, without alpha.
    white : int
        Largest value of integers: that of their type, or that which the file names; 1 of floats.
    compression_loss : float
        See `quantisation_sigma`.
    """

    pixels: NDArray
    white: int
    compression_loss: float = 0.0


def picture_format(data: bytes) -> str:
    """One of `FORMATS`, by the first bytes of a file; an `InputError` if it is none of them."""
    for name, start in _FIRST_BYTES.items():
        if re.match(start, data, re.DOTALL):
            return name
    if found := refused_format(data):
        if found == "GIF":
            raise InputError("GIF, an animation, expected one picture: convert it to PNG")
        raise InputError(f"{found} is not read: convert it to PNG or TIFF")
    raise InputError(_NO_PICTURE)


def decode_picture(data: bytes | memoryview, formats: Sequence[str] = FORMATS) -> StoredPicture:
    """Picture of a file.

    It is read as stored: orientation is ignored, alpha is dropped, no colour profile is applied.

    Parameters
    ----------
    data : bytes
        Content of a file.
    formats : sequence of str
        Those of `FORMATS` that are read; others are refused before anything of them is decoded.

    Raises
    ------
    InputError
        If it is no picture, is of another format, has more than `LARGEST_PIXELS`, is truncated or
        damaged, has several pages or frames, or is stored in a way that would be read as another
        picture.

    Examples
    --------
    >>> data = cv2.imencode(".png", np.zeros((4, 6), np.uint8))[1].tobytes()
    >>> decode_picture(data).pixels.shape
    (4, 6)
    >>> decode_picture(data[:-8])
    Traceback (most recent call last):
    coded_aperture_ros.core.errors.InputError: not a picture, or truncated
    """
    data = bytes(data)
    found = picture_format(data)
    if found not in formats:
        raise InputError(f"a picture in {found}, expected {' or '.join(formats)}")
    if found == "Netpbm":
        return StoredPicture(*read_pnm(data))
    if found == "TIFF":
        pixels = _tiff_pixels(data)
    else:
        _CHECKS[found](data)
        pixels = _decoded(data)
    white = np.iinfo(pixels.dtype).max if pixels.dtype.kind in "ui" else 1
    return StoredPicture(pixels, white, quantisation_sigma(data) if found == "JPEG" else 0.0)


def _check_jpeg(data: bytes) -> None:
    check_jpeg(data)
    # Before decoding, in which libjpeg would print what it makes up.
    if is_damaged_jpeg(data):
        raise InputError("truncated or damaged: a part of the JPEG is missing or wrong")


# What is judged before OpenCV decodes a picture.
_CHECKS: dict[str, Callable[[bytes], None]] = {
    "PNG": check_png,
    "JPEG": _check_jpeg,
    "BMP": check_bmp,
    "WebP": check_webp,
}


def _decoded(data: bytes) -> NDArray:
    """Pixels that OpenCV reads, in RGB order."""
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), _AS_STORED) if data else None
    except (cv2.error, MemoryError) as error:
        raise InputError(_NO_PICTURE) from error
    if pixels is None:
        raise InputError(_NO_PICTURE)
    # A view of reversed channels, which is made contiguous: OpenCV converts no 64-bit floats.
    return np.ascontiguousarray(pixels[..., ::-1]) if pixels.ndim == 3 else pixels


def _tiff_pixels(data: bytes) -> NDArray:
    tiff = readable_tiff(data)
    planes = [_decoded(plane) for plane in tiff.planes]
    pixels = planes[0] if len(planes) == 1 else np.dstack(planes)
    return np.iinfo(pixels.dtype).max - pixels if tiff.white_is_zero else pixels
