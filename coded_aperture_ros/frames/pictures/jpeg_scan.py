"""Entropy-coded data of a JPEG scan, decoded as far as tells whether it is whole (ITU-T T.81)."""

import dataclasses
import logging
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Kinds of scans: of all coefficients; of a progressive file, the first bits and one more bit, of
# the mean value or of the others.
SEQUENTIAL, DC_FIRST, DC_REFINED, AC_FIRST, AC_REFINED = range(5)
CODE_BITS = 16
# The longest codes and bits of a whole block: where data end is looked at after each block.
_PADDING = bytes(1024)
# For the coefficients of scans that no later one refines.
_NOT_KEPT = 1


@dataclasses.dataclass(frozen=True, eq=False)
class Scan:
    """What the header of a scan says.

    Attributes
    ----------
    kind : int
        See `SEQUENTIAL`.
    first, last, low : int
        First and last coefficient, in zigzag order, and the lowest bit that the scan brings.
    order : ndarray, int64 [blocks, 3]
        Component, and numbers of the tables of DC and AC codes, of each block of an MCU.
    codes : ndarray, int32 [8, 65536]
        Tables of DC codes, then of AC codes: 256 times the length plus the symbol of the code that
        16 bits begin with; -1: none.
    largest : ndarray, int64 [components, 64]
        Largest coefficients that there can be.
    """

    kind: int
    first: int
    last: int
    low: int
    order: NDArray[np.int64]
    codes: NDArray[np.int32]
    largest: NDArray[np.int64]


def is_exactly(data: bytes, scan: Scan, nonzero: NDArray[np.bool_] | None, count: int) -> bool:
    """Whether data are so many blocks, and no more.

    Parameters
    ----------
    data : bytes
        Of one restart interval, without stuffed zeros. Zeros at its end do not count, which some
        cameras fill up with.
    scan : Scan
    nonzero : ndarray, bool [count, 64], optional
        Coefficients that the progressive scans so far have brought; this scan adds its own.
    count : int
        Number of blocks.
    """
    loops = _loops()
    if loops is None:
        return True
    used = loops.used_bits(
        np.frombuffer(data + _PADDING, np.uint8),
        8 * len(data),
        scan.order,
        scan.codes,
        scan.largest,
        (scan.kind, scan.first, scan.last, scan.low),
        np.zeros((_NOT_KEPT, 64), np.bool_) if nonzero is None else nonzero,
        count,
    )
    return used >= 0 and not data[-(-int(used) // 8) :].strip(b"\0")


@cache
def _loops() -> Any:
    """Compiled loops; None without numba: Python's own would take seconds a picture."""
    try:
        return import_module("coded_aperture_ros.frames.pictures.jpeg_loops")
    except (ImportError, RuntimeError) as error:  # not installed, or nowhere to cache
        logging.getLogger(__name__).warning(f"damaged JPEG pictures are not recognised: {error}")
        return None
