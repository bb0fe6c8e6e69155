"""The loops over the blocks and coefficients of a JPEG scan; needs numba.

Each returns the number of bits used so far, or -1 if the data cannot be those of a picture. Data
are uint8 without stuffed zeros, with some bytes behind their end: the loops look ahead. A table of
codes, int32 [65536], has 256 times the length plus the symbol of the code that 16 bits begin with,
or -1.
"""

import numpy as np
from numba import njit

from coded_aperture_ros.frames.pictures.jpeg_scan import (
    AC_REFINED,
    DC_FIRST,
    DC_REFINED,
    SEQUENTIAL,
)

_LARGEST_DC_BITS = 11
_LARGEST_AC_BITS = 10
_LONGEST_RUN = 15


@njit(cache=True, nogil=True, inline="always")
def _next_bits(data, at):  # type: ignore[no-untyped-def]
    """The 16 bits at a position."""
    byte = at >> 3
    word = (np.int64(data[byte]) << 16) | (np.int64(data[byte + 1]) << 8) | np.int64(data[byte + 2])
    return (word >> (8 - (at & 7))) & 0xFFFF


@njit(cache=True, nogil=True, inline="always")
def _value(data, at, size):  # type: ignore[no-untyped-def]
    """Signed number of so many bits."""
    value = _next_bits(data, at) >> (16 - size)
    return value if value >> (size - 1) else value + 1 - (1 << size)


@njit(cache=True, nogil=True)
def _mean(data, at, table):  # type: ignore[no-untyped-def]
    """Bits used, and the difference of a block's mean value from the one before."""
    code = np.int64(table[_next_bits(data, at)])
    size = code & 0xFF
    if code < 0 or size > _LARGEST_DC_BITS:
        return np.int64(-1), np.int64(0)
    at += code >> 8
    return at + size, _value(data, at, size) if size else np.int64(0)


@njit(cache=True, nogil=True)
def _band(data, at, table, band, largest, nonzero, sequential):  # type: ignore[no-untyped-def]
    """Bits used, and how many blocks more have nothing in this band of coefficients."""
    k, last, low = band
    while k <= last:
        code = np.int64(table[_next_bits(data, at)])
        if code < 0:
            return np.int64(-1), np.int64(0)
        at += code >> 8
        zeros = (code & 0xFF) >> 4
        size = code & 15
        if size == 0 and zeros < _LONGEST_RUN:
            if sequential:
                return (at if zeros == 0 else np.int64(-1)), np.int64(0)
            more = (_next_bits(data, at) >> 1) >> (15 - zeros)
            return at + zeros, (1 << zeros) - 1 + more
        k += zeros
        if k > last or size > _LARGEST_AC_BITS:
            return np.int64(-1), np.int64(0)
        if size:
            if abs(_value(data, at, size)) << low > largest[k]:
                return np.int64(-1), np.int64(0)
            nonzero[k] = True
            at += size
        k += 1
    return at, np.int64(0)


@njit(cache=True, nogil=True)
def _refined_band(data, at, table, band, nonzero):  # type: ignore[no-untyped-def]
    """The same where a scan brings one more bit of each coefficient."""
    k, last, _ = band
    while k <= last:
        code = np.int64(table[_next_bits(data, at)])
        zeros = (code & 0xFF) >> 4
        size = code & 15
        if code < 0 or size > 1:
            return np.int64(-1), np.int64(0)
        at += code >> 8
        if size == 0 and zeros < _LONGEST_RUN:
            more = (_next_bits(data, at) >> 1) >> (15 - zeros)
            return at + zeros + np.sum(nonzero[k : last + 1]), (1 << zeros) - 1 + more
        at += size
        while k <= last and (nonzero[k] or zeros):
            if nonzero[k]:
                at += 1
            else:
                zeros -= 1
            k += 1
        if size:
            if k > last:
                return np.int64(-1), np.int64(0)
            nonzero[k] = True
        k += 1
    return at, np.int64(0)


@njit(cache=True, nogil=True)
def used_bits(data, bits, order, codes, largest, scan, nonzero, count):  # type: ignore[no-untyped-def]
    """Number of bits of the blocks of a restart interval; see `jpeg_scan.used_bits`."""
    kind, first, last, low = scan
    at = np.int64(0)
    run = np.int64(0)
    means = np.zeros(largest.shape[0], np.int64)
    for number in range(count):
        component, mean_table, band_table = order[number % order.shape[0]]
        row = nonzero[number % nonzero.shape[0]]
        if kind == DC_REFINED:
            at += 1
        elif first == 0:
            at, step = _mean(data, at, codes[mean_table])
            means[component] += step
            if at < 0 or abs(means[component]) << low > largest[component, 0]:
                return np.int64(-1)
        if at > bits:
            return np.int64(-1)
        if kind in (DC_FIRST, DC_REFINED):
            continue
        band = (max(first, 1), last, low)
        if run:
            run -= 1
            at += np.sum(row[first : last + 1]) if kind == AC_REFINED else 0
        elif kind == AC_REFINED:
            at, run = _refined_band(data, at, codes[4 + band_table], band, row)
        else:
            at, run = _band(
                data, at, codes[4 + band_table], band, largest[component], row, kind == SEQUENTIAL
            )
        if at < 0 or at > bits:
            return np.int64(-1)
    return at if run == 0 else np.int64(-1)
