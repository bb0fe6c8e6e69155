"""TIFF files in a layout that OpenCV reads as stored.

OpenCV turns pictures by their orientation, reads separate planes of more than 8 bits as if their
channels were interleaved, ignores that white is zero above 8 bits, multiplies by alpha, and takes
the first of several pages. So the directory of a file is checked, and written anew without them.
"""

import dataclasses
import math
import re
import struct
import zlib

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.input_file import check_picture_size

# Tags of the TIFF 6.0 specification, and of its supplements.
_SUBFILE_TYPE = 254
_WIDTH = 256
_HEIGHT = 257
_BITS = 258
_COMPRESSION = 259
_PHOTOMETRIC = 262
_DESCRIPTION = 270
_STRIP_OFFSETS = 273
_ORIENTATION = 274
_SAMPLES = 277
_STRIP_BYTES = 279
_PLANAR = 284
_TILE_WIDTH = 322
_TILE_HEIGHT = 323
_TILE_OFFSETS = 324
_TILE_BYTES = 325
_EXTRA_SAMPLES = 338
_SAMPLE_FORMAT = 339
_DEPTH = 32997
# Of the type of a page: a smaller version of another, or a mask of its transparency.
_NOT_A_FRAME = 1 | 4
_WHITE_IS_ZERO = 0
_BLACK_IS_ZERO = 1
_RGB = 2
# Photometric interpretations that hold light: grey, RGB, palette, YCbCr, LogL and LogLuv.
_YCBCR = 6
_LIGHT = (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, 3, _YCBCR, 32844, 32845)
_SEPARATE_PLANES = 2
_UNSIGNED = 1
_FLOAT = 3
_ASSOCIATED_ALPHA = 1
_SHORT = 3
# Bytes of one value of each type.
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
_SIZES |= {16: 8, 17: 8, 18: 8}
_LETTERS = {1: "B", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 13: "I", 16: "Q", 17: "q", 18: "Q"}
# Of a pixel: RGB, alpha, and some that programs add.
_MOST_SAMPLES = 16
_DAMAGED = "truncated, or its TIFF directory is damaged"
_UNDECODABLE = "damaged: compressed pixels of the TIFF cannot be decoded"
_UNCOMPRESSED = 1
_DEFLATE = (8, 32946)
# More than any encoder reaches with a picture of one colour.
_LARGEST_COMPRESSION = 20_000
_MAX_PAGES = 10_000
# Entries and strips may share bytes of a file; how many times all of it, at most.
_MOST_SHARED = 4
# Compressed pixels are unpacked for their checksum, so many bytes at once.
_BLOCK_BYTES = 2**20


@dataclasses.dataclass(frozen=True)
class ReadableTiff:
    """TIFF in a layout that OpenCV reads as stored.

    Attributes
    ----------
    planes : tuple of bytes
        The file, or files of one grey channel each.
    white_is_zero : bool
        Whether the values read are to be subtracted from the largest.
    """

    planes: tuple[bytes, ...]
    white_is_zero: bool


@dataclasses.dataclass(frozen=True)
class _Entry:
    kind: int
    count: int
    content: bytes


_Directory = dict[int, _Entry]


class _Layout:
    """Byte order of a file, and the sizes of what its directories consist of."""

    def __init__(self, data: bytes) -> None:
        self.order = "<" if data.startswith(b"II") else ">"
        (version,) = struct.unpack_from(f"{self.order}H", data, 2)
        self.big = version == 43
        self.count, self.offset = ("Q", "Q") if self.big else ("H", "I")
        self.first_at = 8 if self.big else 4
        self.inline = struct.calcsize(self.offset)
        self._left = _MOST_SHARED * len(data)

    def unpack(self, letters: str, data: bytes, at: int) -> tuple[int, ...]:
        return struct.unpack_from(self.order + letters, data, at)

    def pack(self, letters: str, *values: int) -> bytes:
        return struct.pack(self.order + letters, *values)

    def directory(self, data: bytes, at: int) -> tuple[_Directory, int]:
        """Entries of the directory at an offset, and the offset of the next one; 0: none."""
        (entries,) = self.unpack(self.count, data, at)
        at += struct.calcsize(self.order + self.count)
        found: _Directory = {}
        for _ in range(entries):
            tag, kind, count = self.unpack(f"HH{self.offset}", data, at)
            at += 4 + self.inline
            size = _SIZES.get(kind, 1) * count
            start = at if size <= self.inline else self.unpack(self.offset, data, at)[0]
            self._left -= size
            if start + size > len(data) or self._left < 0:
                raise InputError(_DAMAGED)
            found[tag] = _Entry(kind, count, data[start : start + size])
            at += self.inline
        return found, self.unpack(self.offset, data, at)[0]

    def numbers(self, entry: _Entry | None, default: tuple[int, ...] = ()) -> tuple[int, ...]:
        """Values of an entry of whole numbers."""
        if entry is None or entry.kind not in _LETTERS:
            return default
        return self.unpack(f"{entry.count}{_LETTERS[entry.kind]}", entry.content, 0)

    def with_directory(self, data: bytes, directory: _Directory) -> bytes:
        """Copy of a file with another first directory, which is its only one."""
        start = len(data) + len(data) % 2
        length = struct.calcsize(self.order + self.count)
        length += len(directory) * (4 + 2 * self.inline) + self.inline
        table = self.pack(self.count, len(directory))
        beyond = b""
        for tag, entry in sorted(directory.items()):
            table += self.pack(f"HH{self.offset}", tag, entry.kind, entry.count)
            if len(entry.content) <= self.inline:
                table += entry.content.ljust(self.inline, b"\0")
                continue
            table += self.pack(self.offset, start + length + len(beyond))
            beyond += entry.content + b"\0" * (len(entry.content) % 2)
        table += self.pack(self.offset, 0)
        head = data[: self.first_at] + self.pack(self.offset, start)
        return head + data[len(head) :].ljust(start - len(head), b"\0") + table + beyond

    def short(self, *values: int) -> _Entry:
        """Entry of 16-bit numbers."""
        return _Entry(_SHORT, len(values), self.pack(f"{len(values)}H", *values))


def readable_tiff(data: bytes) -> ReadableTiff:
    """TIFF of the same stored pixels that OpenCV reads as they are.

    Parameters
    ----------
    data : bytes
        A TIFF or BigTIFF file.

    Raises
    ------
    InputError
        If the file is truncated, or its pages, channels or numbers are not those of one picture.
    """
    try:
        layout = _Layout(data)
        (first,) = layout.unpack(layout.offset, data, layout.first_at)
        directory, following = layout.directory(data, first)
        _check_size(layout, directory)
        _check_pages(layout, data, directory, following)
        _check_extent(layout, data, directory)
        _check_light(layout, directory)
        return _rewritten(layout, data, directory)
    except InputError:
        raise
    except (struct.error, ValueError, LookupError, ArithmeticError) as error:
        raise InputError(_DAMAGED) from error


def _check_size(layout: _Layout, directory: _Directory) -> None:
    """Refuse a picture, or tiles of one, that nobody should allocate."""
    for wide, high in ((_WIDTH, _HEIGHT), (_TILE_WIDTH, _TILE_HEIGHT)):
        rows, columns = (layout.numbers(directory.get(tag), (1,))[0] for tag in (high, wide))
        check_picture_size(rows, columns)
    samples = layout.numbers(directory.get(_SAMPLES), (1,))[0]
    if samples > _MOST_SAMPLES:
        raise InputError(f"TIFF of {samples} channels, expected grey or RGB")


def _check_pages(layout: _Layout, data: bytes, first: _Directory, following: int) -> None:
    """Refuse several frames; smaller versions of a picture and masks beside it are none."""
    pages = 0
    directory = first
    for _ in range(_MAX_PAGES):
        kind = layout.numbers(directory.get(_SUBFILE_TYPE), (0,))[0]
        pages += not kind & _NOT_A_FRAME
        if not following:
            break
        directory, following = layout.directory(data, following)
    if layout.numbers(first.get(_SUBFILE_TYPE), (0,))[0] & _NOT_A_FRAME:
        raise InputError(
            "TIFF whose first page is a preview, as in a camera's raw file (DNG): convert it to a "
            "16-bit TIFF"
        )
    if first.get(_DESCRIPTION) is not None:  # ImageJ lists the first page of long stacks only
        noted = re.match(rb"ImageJ=[^\n]*\n(?:.*\n)*?images=(\d+)", first[_DESCRIPTION].content)
        pages = max(pages, int(noted[1]) if noted else 1)
    pages = max(pages, layout.numbers(first.get(_DEPTH), (1,))[0])
    if pages > 1:
        raise InputError(f"TIFF of {pages} pages, expected one: write each into a file of its own")


def _check_extent(layout: _Layout, data: bytes, directory: _Directory) -> None:
    """Refuse a file that lacks some of its pixels; OpenCV would return those that are there."""
    for at, length in ((_STRIP_OFFSETS, _STRIP_BYTES), (_TILE_OFFSETS, _TILE_BYTES)):
        starts = layout.numbers(directory.get(at))
        lengths = layout.numbers(directory.get(length))
        if sum(lengths) > _MOST_SHARED * len(data):
            raise InputError(_DAMAGED)
        ends = map(sum, zip(starts, lengths, strict=True))
        if max(ends, default=0) > len(data):
            raise InputError("truncated: the file ends before its pixels do")
        if lengths and sum(lengths) < _least_bytes(layout, directory):
            raise InputError("truncated: there are fewer pixels than its size says")
        if layout.numbers(directory.get(_COMPRESSION), (1,))[0] in _DEFLATE:
            left = _most_bytes(layout, directory)
            for start, count in zip(starts, lengths, strict=True):
                left -= _check_deflated(data[start : start + count], left)


def _least_bytes(layout: _Layout, directory: _Directory) -> float:
    """Number of bytes that pixels of the declared size take at least."""
    first = {
        tag: layout.numbers(directory.get(tag), (1,))[0]
        for tag in (_WIDTH, _HEIGHT, _SAMPLES, _BITS, _COMPRESSION, _PHOTOMETRIC)
    }
    whole = first[_WIDTH] * first[_HEIGHT] * first[_SAMPLES] * first[_BITS] / 8
    if first[_COMPRESSION] != _UNCOMPRESSED:
        return whole / _LARGEST_COMPRESSION
    return whole / 2 if first[_PHOTOMETRIC] == _YCBCR else whole  # with colours at half the size


def _most_bytes(layout: _Layout, directory: _Directory) -> int:
    """Number of bytes that pixels of the declared size take at most, with tiles beyond the edge."""
    values = [
        layout.numbers(directory.get(tag), (1,))[0] for tag in (_WIDTH, _HEIGHT, _SAMPLES, _BITS)
    ]
    return _MOST_SHARED * math.prod(values) // 8 + _BLOCK_BYTES


def _check_deflated(coded: bytes, most: int) -> int:
    """Number of unpacked bytes, after a check of the checksum.

    OpenCV returns what there is of 8 bits if it is wrong. `most` is the number that may come.
    """
    unpacker = zlib.decompressobj()
    count = 0
    try:
        while not unpacker.eof:
            block = unpacker.decompress(coded, _BLOCK_BYTES)
            coded = unpacker.unconsumed_tail
            count += len(block)
            if count > most or not (block or coded or unpacker.eof):
                break
    except zlib.error as error:
        raise InputError(_UNDECODABLE) from error
    if not unpacker.eof:
        raise InputError(_UNDECODABLE)
    return count


def _check_light(layout: _Layout, directory: _Directory) -> None:
    """Refuse pixels whose numbers OpenCV would take for others."""
    photometric = layout.numbers(directory.get(_PHOTOMETRIC), (_BLACK_IS_ZERO,))[0]
    if photometric not in _LIGHT:
        raise InputError(
            f"TIFF with the photometric interpretation {photometric}, expected grey or RGB: "
            "convert it"
        )
    bits = layout.numbers(directory.get(_BITS), (1,))
    kinds = layout.numbers(directory.get(_SAMPLE_FORMAT), (1,))
    if len(set(bits)) > 1:
        raise InputError(f"TIFF whose channels have {', '.join(map(str, bits))} bits: convert it")
    if kinds[0] == _FLOAT and bits[0] not in (32, 64):
        raise InputError(f"TIFF of floats of {bits[0]} bits, expected 32 or 64: convert it")
    if photometric == _WHITE_IS_ZERO and kinds[0] != _UNSIGNED:
        raise InputError("TIFF of signed numbers with white as zero, expected black: convert it")
    samples = layout.numbers(directory.get(_SAMPLES), (1,))[0]
    planar = layout.numbers(directory.get(_PLANAR), (1,))[0]
    if samples == 2 and planar != _SEPARATE_PLANES and bits[0] > 8:
        raise InputError(f"TIFF of grey and alpha of {bits[0]} bits: save it without alpha")


def _rewritten(layout: _Layout, data: bytes, directory: _Directory) -> ReadableTiff:
    """Copy without orientation, inversion, alpha's product, further pages, separate planes."""
    changed = {tag: entry for tag, entry in directory.items() if tag != _ORIENTATION}
    photometric = layout.numbers(directory.get(_PHOTOMETRIC), (_BLACK_IS_ZERO,))[0]
    white_is_zero = photometric == _WHITE_IS_ZERO
    if white_is_zero:
        changed[_PHOTOMETRIC] = layout.short(_BLACK_IS_ZERO)
    if _EXTRA_SAMPLES in changed:
        extra = changed[_EXTRA_SAMPLES].count
        changed[_EXTRA_SAMPLES] = layout.short(*[_ASSOCIATED_ALPHA] * extra)
    samples = layout.numbers(directory.get(_SAMPLES), (1,))[0]
    planar = layout.numbers(directory.get(_PLANAR), (1,))[0]
    if samples == 1 or planar != _SEPARATE_PLANES:
        return ReadableTiff((layout.with_directory(data, changed),), white_is_zero)
    if photometric not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB):
        raise InputError(
            f"TIFF with separate planes of the photometric interpretation {photometric}: convert it"
        )
    # Without alpha and other extra samples.
    planes = range(3 if photometric == _RGB else 1)
    return ReadableTiff(
        tuple(
            layout.with_directory(data, _plane(layout, changed, plane, samples)) for plane in planes
        ),
        white_is_zero,
    )


def _plane(layout: _Layout, directory: _Directory, plane: int, samples: int) -> _Directory:
    """Directory of one of several planes, as a grey picture."""
    single = {tag: entry for tag, entry in directory.items() if tag != _EXTRA_SAMPLES}
    single[_PHOTOMETRIC] = layout.short(_BLACK_IS_ZERO)
    single[_SAMPLES] = layout.short(1)
    single[_PLANAR] = layout.short(1)
    for tag in (_BITS, _SAMPLE_FORMAT):
        if tag in single:
            single[tag] = layout.short(layout.numbers(single[tag])[0])
    for tag in (_STRIP_OFFSETS, _STRIP_BYTES, _TILE_OFFSETS, _TILE_BYTES):
        if tag in single:
            entry = single[tag]
            size = _SIZES[entry.kind]
            count = entry.count // samples
            content = entry.content[plane * count * size : (plane + 1) * count * size]
            single[tag] = _Entry(entry.kind, count, content)
    return single
