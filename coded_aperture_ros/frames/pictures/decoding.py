"""Pixels of picture files and compressed messages, as the sensor's rows and columns stored them."""

import dataclasses
import re

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames.pictures.jpeg import is_damaged_jpeg, quantisation_sigma
from coded_aperture_ros.frames.pictures.png import check_png
from coded_aperture_ros.frames.pictures.pnm import read_pnm
from coded_aperture_ros.frames.pictures.tiff import readable_tiff

# Without EXIF's rotation: a rotated picture would not match the mask.
_AS_STORED = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
_NO_PICTURE = "not a picture, or truncated"
# How files of the formats begin that OpenCV does not read as they are stored, or not safely.
_FORMATS = {
    "jpeg": rb"\xff\xd8\xff",
    "png": rb"\x89PNG\r\n\x1a\n",
    "tiff": rb"II[*+]\0|MM\0[*+]",
    "netpbm": rb"P[1-7fF][\s#]",
    "animation": rb"GIF8|RIFF.{4}WEBP.{0,60}ANIM",
}


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


def decode_picture(data: bytes | memoryview) -> StoredPicture:
    """Picture in any format that OpenCV reads, or of Netpbm.

    It is read as stored: orientation is ignored, alpha is dropped, no colour profile is applied.

    Parameters
    ----------
    data : bytes
        Content of a file.

    Raises
    ------
    InputError
        If it is no picture, is truncated or damaged, has several pages or frames, or is stored in
        a way that would be read as another picture.

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
    kind = _format(data)
    if kind == "netpbm":
        return StoredPicture(*read_pnm(data))
    if kind == "animation":
        raise InputError("an animation, expected one picture: write each frame into a file")
    if kind == "png":
        check_png(data)
    # Before decoding, in which libjpeg would print what it makes up.
    if kind == "jpeg" and is_damaged_jpeg(data):
        raise InputError("truncated or damaged: a part of the JPEG is missing or wrong")
    pixels = _tiff_pixels(data) if kind == "tiff" else _decoded(data)
    white = np.iinfo(pixels.dtype).max if pixels.dtype.kind in "ui" else 1
    return StoredPicture(pixels, white, quantisation_sigma(data) if kind == "jpeg" else 0.0)


def _format(data: bytes) -> str:
    """One of `_FORMATS`; empty for another one."""
    for kind, start in _FORMATS.items():
        if re.match(start, data, re.DOTALL):
            return kind
    return ""


def _decoded(data: bytes) -> NDArray:
    """Pixels that OpenCV reads, in RGB order."""
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), _AS_STORED) if data else None
    except cv2.error as error:
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
