"""JPEG files: whether all of a picture is there, and the noise of its compression (ITU-T T.81)."""

import dataclasses
import re
import struct
from collections.abc import Iterator
from functools import cache, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.input_file import LARGEST_PIXELS, check_picture_size
from coded_aperture_ros.frames.pictures.jpeg_scan import (
    AC_FIRST,
    AC_REFINED,
    CODE_BITS,
    DC_FIRST,
    DC_REFINED,
    SEQUENTIAL,
    Scan,
    is_exactly,
)

_START = b"\xff\xd8"
_MARKER = 0xFF
_HUFFMAN_TABLES = 0xC4
_END = 0xD9
_SCAN = 0xDA
_TABLES = 0xDB
_NUMBER_OF_LINES = 0xDC
_RESTART_INTERVAL = 0xDD
_BASELINE, _EXTENDED, _PROGRESSIVE = 0xC0, 0xC1, 0xC2
_JUDGED = (_BASELINE, _EXTENDED, _PROGRESSIVE)
# Lossless, hierarchical and arithmetic frames, and a number of lines that comes behind the scan.
_NOT_JUDGED = {*range(0xC3, 0xD0), _NUMBER_OF_LINES} - {_HUFFMAN_TABLES, 0xC8, 0xCC}
# Markers with no length behind them.
_ALONE = {0x01, *range(0xD0, 0xD8)}
# The marker that ends the data of a scan, or divides them.
_DIVIDER = re.compile(rb"\xff+([\x01-\xfe])")
_RESTARTS = range(0xD0, 0xD8)
_PROGRESSIVE_KINDS = (_PROGRESSIVE, 0xC6, 0xCA, 0xCE)
# A scan of few bytes may go over all pixels. Encoders write ten.
_MOST_SCANNED_PIXELS = 16 * LARGEST_PIXELS
_MOST_SCANS = 1000
_BLOCK_PX = 8
_DC_TABLES = range(4)
_AC_TABLES = range(16, 20)
# Largest coefficients of pictures of 8 bits are 1024; encoders that soften ringing go beyond.
_LARGEST = 1280
# Noise over the rounding of the median coefficient: best for depth from quality 95 down to 50.
_NOISE_SHARE = 0.35


@dataclasses.dataclass(frozen=True)
class _Component:
    across: int
    down: int
    table: int


@dataclasses.dataclass
class _Frame:
    """What the segments of a file have said so far."""

    progressive: bool = False
    rows: int = 0
    columns: int = 0
    components: dict[int, _Component] = dataclasses.field(default_factory=dict)
    steps: dict[int, NDArray[np.int64]] = dataclasses.field(default_factory=dict)
    codes: dict[int, bytes] = dataclasses.field(default_factory=dict)
    interval: int = 0
    nonzero: dict[int, NDArray[np.bool_]] = dataclasses.field(default_factory=dict)
    scanned: set[int] = dataclasses.field(default_factory=set)


def check_jpeg(data: bytes) -> None:
    """Raise `InputError` if a JPEG declares a picture that is too large, or too many scans."""
    pixels = 0
    progressive = False
    scans = 0
    try:
        for kind, segment, _ in _segments(data):
            if kind in (*_JUDGED, *_NOT_JUDGED) and kind != _NUMBER_OF_LINES:
                rows, columns = struct.unpack_from(">HH", segment, 1)
                check_picture_size(rows, columns)
                pixels = rows * columns
                progressive = kind in _PROGRESSIVE_KINDS
            elif kind == _SCAN:
                scans += 1
                if scans > _MOST_SCANS or scans * pixels > _MOST_SCANNED_PIXELS:
                    raise InputError(f"{scans} scans or more, expected a JPEG as encoders write it")
                if not progressive:
                    return
    except struct.error as error:
        raise InputError("truncated or damaged: a header of the JPEG is wrong") from error


def is_damaged_jpeg(data: bytes) -> bool:
    """Whether a part of the picture is missing or is not what an encoder wrote.

    Decoders fill it with grey or with shifted blocks. The Huffman codes of all blocks are read:
    they must end where the data of their restart interval do, and give coefficients that a picture
    of 8 bits can have. Bytes behind the end marker do not count.

    Parameters
    ----------
    data : bytes
        A JPEG file that has a header; sequential or progressive. Others, with arithmetic codes or
        without loss, are not judged, nor is any without numba.

    Examples
    --------
    >>> picture = np.arange(4096, dtype=np.uint8).reshape(64, 64)
    >>> whole = cv2.imencode(".jpg", picture)[1].tobytes()
    >>> is_damaged_jpeg(whole), is_damaged_jpeg(whole[:-300] + whole[-2:])
    (False, True)
    """
    frame = _Frame()
    try:
        for kind, segment, end in _segments(data):
            if kind in _NOT_JUDGED:
                return False
            if kind == _SCAN:
                if _is_damaged_scan(frame, segment, data[end : _end_of_scan(data, end)]):
                    return True
            elif not _note(frame, kind, segment):
                return False
    except (struct.error, LookupError, ArithmeticError, ValueError):
        return True  # a header that is no header
    return frame.scanned != set(frame.components)


def quantisation_sigma(data: bytes) -> float:
    """Standard deviation of JPEG's quantisation, of stored values in [0, 1]; 0 without JPEG.

    It is a third of the rounding of the median luminance coefficient.
    """
    if not data.startswith(_START):
        return 0.0
    frame = _Frame()
    try:
        for kind, segment, _ in _segments(data):
            if kind == _TABLES:
                _note(frame, kind, segment)
            if 0 in frame.steps:  # of the luminance
                return float(_NOISE_SHARE * np.median(frame.steps[0]) / 255 / np.sqrt(12))
    except (struct.error, IndexError, ValueError):
        pass
    return 0.0


def _segments(data: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Yield kind and content of every segment up to the end marker, and where it ends."""
    at = len(_START)
    while at + 4 <= len(data):
        if data[at] != _MARKER:
            at = data.find(_MARKER, at)  # as decoders do
            if at < 0:
                return
            continue
        kind = data[at + 1]
        if kind == _MARKER:
            at += 1
            continue
        if kind == 0 or kind in _ALONE:
            at += 2
            continue
        if kind == _END:
            return
        (length,) = struct.unpack_from(">H", data, at + 2)
        end = at + 2 + length
        yield kind, data[at + 4 : end], end
        at = _end_of_scan(data, end) if kind == _SCAN else end


def _end_of_scan(data: bytes, start: int) -> int:
    """Where the next marker is that is no restart marker."""
    for found in _DIVIDER.finditer(data, start):
        if found[1][0] not in _RESTARTS:
            return found.start()
    return len(data)


def _note(frame: _Frame, kind: int, segment: bytes) -> bool:
    """Take down what a segment says; False if the file cannot be judged."""
    if kind in _JUDGED:
        bits, frame.rows, frame.columns, count = struct.unpack_from(">BHHB", segment)
        frame.progressive = kind == _PROGRESSIVE
        for index in range(count):
            name, sampling, table = segment[6 + 3 * index : 9 + 3 * index]
            frame.components[name] = _Component(sampling >> 4, sampling & 15, table)
        return bits == 8
    if kind == _TABLES:
        at = 0
        while at < len(segment):
            wide = segment[at] >> 4
            steps = np.frombuffer(segment, ">u2" if wide else np.uint8, 64, at + 1)
            frame.steps[segment[at] & 15] = steps.astype(np.int64)
            at += 1 + 64 * (2 if wide else 1)
    elif kind == _HUFFMAN_TABLES:
        frame.codes |= _huffman_tables(segment)
    elif kind == _RESTART_INTERVAL:
        (frame.interval,) = struct.unpack_from(">H", segment)
    return True


def _huffman_tables(segment: bytes) -> dict[int, bytes]:
    """Definitions of tables by their number: 0 to 3 for DC, 16 to 19 for AC."""
    tables = {}
    at = 0
    while at < len(segment):
        length = 17 + sum(segment[at + 1 : at + 17])
        if at + length > len(segment):
            raise ValueError("a table is cut off")
        tables[segment[at]] = segment[at + 1 : at + length]
        at += length
    return tables


@cache
def _standard_tables() -> dict[int, bytes]:
    """Tables of frames without any, as cameras with motion JPEG send: those of the standard."""
    data = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    tables: dict[int, bytes] = {}
    for kind, segment, _ in _segments(data):
        if kind == _HUFFMAN_TABLES:
            tables |= _huffman_tables(segment)
    return tables


@lru_cache(16)
def _lookup(definition: bytes) -> NDArray[np.int32]:
    """Length and symbol of the code that 16 bits begin with, see `Scan`."""
    found = np.full(1 << CODE_BITS, -1, np.int32)
    at = 0
    symbols = iter(definition[16:])
    for length, count in enumerate(definition[:16], 1):
        share = 1 << (CODE_BITS - length)
        for _ in range(count):
            found[at : at + share] = length << 8 | next(symbols)
            at += share
    return found


@lru_cache(4)
def _lookups(definitions: tuple[bytes, ...]) -> NDArray[np.int32]:
    empty = np.full(1 << CODE_BITS, -1, np.int32)
    return np.stack([_lookup(each) if each else empty for each in definitions])


def _is_damaged_scan(frame: _Frame, header: bytes, data: bytes) -> bool:
    """Whether the data of a scan are not exactly its blocks."""
    names = header[1 : 1 + 2 * header[0] : 2]
    components = [frame.components[name] for name in names]
    scan = _scan(frame, header, components)
    count = _mcu_count(frame, components)
    nonzero = None
    if scan.first == 0:
        if count > 8 * len(data):  # every block has a bit: a size that nobody should allocate
            return True
        frame.scanned |= set(names)
    else:
        if names[0] not in frame.scanned:
            return True
        nonzero = frame.nonzero.setdefault(names[0], np.zeros((count, 64), np.bool_))
    length = frame.interval or count
    intervals = _restart_intervals(data)
    if intervals is None or len(intervals) != -(-count // length):
        return True
    for number, coded in enumerate(intervals):
        start = number * length
        blocks = min(length, count - start) * len(scan.order)
        kept = None if nonzero is None else nonzero[start : start + length]
        if not is_exactly(coded, scan, kept, blocks):
            return True
    return False


def _scan(frame: _Frame, header: bytes, components: list[_Component]) -> Scan:
    """What the header of a scan says."""
    tables = header[2 : 2 + 2 * header[0] : 2]
    first, last, bits = header[1 + 2 * header[0] :][:3]
    kind = SEQUENTIAL
    if frame.progressive:
        dc, ac = (DC_REFINED, AC_REFINED) if bits >> 4 else (DC_FIRST, AC_FIRST)
        kind = ac if first else dc
    order = [
        (index, table >> 4, table & 15)
        for index, (component, table) in enumerate(zip(components, tables, strict=True))
        for _ in range(component.across * component.down if len(components) > 1 else 1)
    ]
    known = all(table >> 4 in _DC_TABLES and table & 15 in _DC_TABLES for table in tables)
    if not (known and first <= last < 64):
        raise ValueError("a scan of tables or coefficients that there are not")
    if not order:
        raise ValueError("a scan without blocks")
    codes = frame.codes if frame.progressive else _standard_tables() | frame.codes
    steps = [frame.steps[component.table] for component in components]
    return Scan(
        kind,
        first if frame.progressive else 0,
        last if frame.progressive else 63,
        bits & 15,
        np.array(order),
        _lookups(tuple(codes.get(number, b"") for number in (*_DC_TABLES, *_AC_TABLES))),
        np.array([(_LARGEST + each) // np.maximum(each, 1) for each in steps]),
    )


def _restart_intervals(data: bytes) -> list[bytes] | None:
    """Data between restart markers, without stuffed zeros; None if a marker is missing."""
    found = list(_DIVIDER.finditer(data))
    if any(mark[1][0] != 0xD0 + index % 8 for index, mark in enumerate(found)):
        return None
    starts = [0, *(mark.end() for mark in found)]
    ends = [*(mark.start() for mark in found), len(data)]
    return [
        data[start:end].replace(b"\xff\x00", b"\xff")
        for start, end in zip(starts, ends, strict=True)
    ]


def _mcu_count(frame: _Frame, components: list[_Component]) -> int:
    """Number of groups of blocks in a scan; one component by itself has only blocks with pixels."""
    across = max(each.across for each in frame.components.values())
    down = max(each.down for each in frame.components.values())
    if len(components) == 1:
        columns = -(-frame.columns * components[0].across // across)
        rows = -(-frame.rows * components[0].down // down)
        return -(-columns // _BLOCK_PX) * -(-rows // _BLOCK_PX)
    columns = -(-frame.columns // (_BLOCK_PX * across))
    rows = -(-frame.rows // (_BLOCK_PX * down))
    return columns * rows
