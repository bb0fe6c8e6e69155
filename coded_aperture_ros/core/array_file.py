"""Arrays as NumPy stores them (.npy): the header is judged before its data are read."""

import io
import math
import tokenize
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

# Numbers, switches and text; objects would be unpickled.
_KINDS = "biufcUS"
# NumPy's own limit; it reads headers with Python's parser.
_LONGEST_HEADER = 10_000
_READ_HEADER = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
# What NumPy raises for a damaged header.
_HEADER_ERRORS = (ValueError, TypeError, SyntaxError, tokenize.TokenError, RecursionError)


def read_array(data: bytes) -> NDArray[Any]:
    """Array of the content of a file, as a view of it; nothing is unpickled.

    Raises
    ------
    ValueError
        If it is truncated, damaged, or no array of numbers or text.

    Examples
    --------
    >>> content = io.BytesIO()
    >>> np.save(content, [1, 4, 9])
    >>> read_array(content.getvalue())
    array([1, 4, 9])
    """
    # Version 3 differs in names of fields, which arrays of numbers do not have.
    head = io.BytesIO(data[: _LONGEST_HEADER + npy.MAGIC_LEN + 4])
    try:
        shape, by_columns, dtype = _READ_HEADER[npy.read_magic(head)](head)
    except KeyError as error:
        raise ValueError("a version of .npy that is not supported") from error
    except _HEADER_ERRORS as error:
        raise ValueError("no .npy array, or its header is damaged") from error
    if dtype.kind not in _KINDS or dtype.subdtype is not None:
        raise ValueError(f"an array of {dtype.kind!r}, expected numbers or text")
    count = math.prod(shape)
    declared = count * dtype.itemsize
    if min(shape, default=0) < 0 or declared > len(data) - head.tell():
        raise ValueError(f"truncated: it has {len(data)} bytes, its header says {declared}")
    if dtype.itemsize == 0 or count == 0:
        return np.zeros(shape, dtype)
    flat = np.frombuffer(data, dtype, count, head.tell())
    return flat.reshape(shape, order="F" if by_columns else "C")
