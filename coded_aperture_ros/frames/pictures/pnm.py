"""Netpbm's formats (PBM, PGM, PPM, PAM) and PFM, with a largest value of their own."""

import math
import re
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.input_file import check_picture_size
from coded_aperture_ros.core.text import short

_PBM = (b"P1", b"P4")
_ASCII = (b"P1", b"P2", b"P3")
_COLOUR = (b"P3", b"P6", b"PF")
_FLOAT = (b"Pf", b"PF")
_PAM = b"P7"
_PAM_END = b"ENDHDR\n"
# Spaces and comments between the words of a header.
_SPACE = rb"(?:\s|#[^\n]*\n)+"
_MAX_VALUE = 65535
_MAX_DIGITS = 9
# A number of channels with alpha, and the number without.
_WITHOUT_ALPHA = {1: 1, 2: 1, 3: 3, 4: 3}


def read_pnm(data: bytes) -> tuple[NDArray, int]:
    """Pixels as stored, and the largest value that they can have.

    Parameters
    ----------
    data : bytes
        A PBM, PGM, PPM or PAM file, binary or ASCII, or a PFM file.

    Returns
    -------
    pixels : ndarray, uint8, uint16 or float32 [rows, columns] or [rows, columns, RGB]
        Without alpha. Rows of a PFM, which begins with the lowest, are in the usual order.
    white : int
        Of integers; 1 of floats.

    Raises
    ------
    InputError
        If the header is not one, a value is above its largest, or the file is truncated.

    Examples
    --------
    >>> pixels, white = read_pnm(b"P2 2 1 1023 0 1023 ")
    >>> pixels.tolist(), white
    ([[0, 1023]], 1023)
    """
    kind = data[:2]
    if kind == _PAM:
        return _read_pam(data)
    numbers = 2 if kind in _PBM else 3
    words = rb"(-?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)"
    header = re.match(kind + (_SPACE + words) * numbers + rb"(?:#[^\n]*\n|\s)", data)
    if header is None:
        raise InputError("truncated, or its Netpbm header is damaged")
    channels = 3 if kind in _COLOUR else 1
    columns, rows = (_whole(word, "size") for word in header.groups()[:2])
    check_picture_size(rows, columns)
    shape = rows, columns, channels
    if kind in _FLOAT:
        return _read_floats(data[header.end() :], shape, float(header[3])), 1
    white = 1 if kind in _PBM else _whole(header[3], "largest value")
    return _integers(data[header.end() :], kind, shape, white), white


def _read_pam(data: bytes) -> tuple[NDArray, int]:
    end = data.find(_PAM_END)
    if end < 0:
        raise InputError("truncated, or its Netpbm header is damaged")
    lines = [line.split(None, 1) for line in data[3:end].splitlines() if line[:1] != b"#"]
    words = {line[0]: line[1] for line in lines if len(line) == 2}
    columns, rows, channels, white = (
        _whole(words.get(name, b""), name.decode())
        for name in (b"WIDTH", b"HEIGHT", b"DEPTH", b"MAXVAL")
    )
    if channels not in _WITHOUT_ALPHA:
        raise InputError(f"PAM of {channels} channels, expected grey or RGB")
    check_picture_size(rows, columns)
    shape = rows, columns, channels
    pixels = _integers(data[end + len(_PAM_END) :], _PAM, shape, white)
    return pixels, white


def _integers(body: bytes, kind: bytes, shape: tuple[int, int, int], white: int) -> NDArray:
    """Pixels of integers, without alpha."""
    if white > _MAX_VALUE:
        raise InputError(f"largest value {white} in the Netpbm header, expected up to {_MAX_VALUE}")
    if kind == b"P4":
        return _read_bits(body, shape)
    if kind in _ASCII:
        values = _read_words(body, kind, shape)
    else:
        stored = np.dtype(np.uint8 if white < 256 else ">u2")
        count = math.prod(shape)
        if len(body) < count * stored.itemsize:
            raise InputError("truncated: the file ends before its pixels do")
        values = np.frombuffer(body, stored, count)
    if values.max() > white:
        raise InputError(f"value {values.max()} above the largest of the Netpbm header, {white}")
    pixels = values.astype(np.uint8 if white < 256 else np.uint16).reshape(shape)
    if kind == b"P1":
        pixels = 1 - pixels  # black is 1
    kept = _WITHOUT_ALPHA[shape[2]]
    return pixels[..., 0] if kept == 1 else np.ascontiguousarray(pixels[..., :kept])


def _read_words(body: bytes, kind: bytes, shape: tuple[int, int, int]) -> NDArray:
    """Values of an ASCII file; those of a PBM need no space between."""
    body = re.sub(rb"#[^\n]*", b"", body)
    words = re.finditer(rb"[01]" if kind == b"P1" else rb"\d+", body)
    count = math.prod(shape)
    found = islice(words, count)
    values = np.fromiter((min(int(word[0][:6]), 2 * _MAX_VALUE) for word in found), np.int32)
    if len(values) < count:
        raise InputError("truncated: the file ends before its pixels do")
    return values


def _read_bits(body: bytes, shape: tuple[int, int, int]) -> NDArray:
    rows, columns, _ = shape
    row_bytes = -(-columns // 8)
    if len(body) < rows * row_bytes:
        raise InputError("truncated: the file ends before its pixels do")
    packed = np.frombuffer(body, np.uint8, rows * row_bytes).reshape(rows, row_bytes)
    return 1 - np.unpackbits(packed, axis=1)[:, :columns]


def _read_floats(body: bytes, shape: tuple[int, int, int], scale: float) -> NDArray:
    """Floats, whose scale is negative if their lowest byte comes first."""
    count = math.prod(shape)
    if len(body) < 4 * count:
        raise InputError("truncated: the file ends before its pixels do")
    values = np.frombuffer(body, "<f4" if scale < 0 else ">f4", count).astype(np.float32)
    pixels = np.ascontiguousarray(values.reshape(shape)[::-1])
    return pixels[..., 0] if shape[2] == 1 else pixels


def _whole(word: bytes, what: str) -> int:
    """Number of a header, above zero."""
    word = word.strip()
    if not word.isdigit() or len(word) > _MAX_DIGITS or int(word) == 0:
        shown = short(word.decode("ascii", "replace"))
        raise InputError(f"{what} {shown} in the Netpbm header")
    return int(word)
