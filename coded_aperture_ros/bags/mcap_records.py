"""Records of MCAP files, also of damaged ones.

An MCAP file is a row of records, each with its kind and length (https://mcap.dev/spec). Messages
stand in chunks, which may be compressed and may have a checksum, or by themselves. rosbags wants a
whole file with messages of ROS 2 alone. The package `mcap` reads streams, but gives out a message
that was cut in the middle, and jumps over holes, both without a word.
"""

import dataclasses
import io
import mmap
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from typing import BinaryIO

from rosbags.rosbag2.storage_mcap import read_bytes, read_string

from coded_aperture_ros.bags.compression import LARGEST_UNPACKED_BYTES, unpacked_chunk
from coded_aperture_ros.bags.contents import ForeignSchema
from coded_aperture_ros.bags.damage import DAMAGE

MAGIC = b"\x89MCAP0\r\n"
HEADER = 0x01
FOOTER = 0x02
SCHEMA = 0x03
CHANNEL = 0x04
MESSAGE = 0x05
CHUNK = 0x06
ATTACHMENT = 0x09
STATISTICS = 0x0B
METADATA_RECORD = 0x0C
_DATA_END = 0x0F
# Kind and length of a record.
RECORD = struct.Struct("<BQ")
# Channel, number in the sequence, times of recording and sending; the data follows.
MESSAGE_HEADER = struct.Struct("<HIQQ")
# Start and end time, size and checksum; compression, length of the records and these follow.
_CHUNK_HEADER = struct.Struct("<QQQI")
# The header, and the name of a compression of any length that there is, bytes.
_CHUNK_START_BYTES = 128
# The header of a chunk, which can be told from other bytes by its two lengths.
_CHUNK_PATTERN = re.compile(
    rb"\x06(.{6}\0\0)(.{28})(\0\0\0\0|\x03\0\0\0lz4|\x04\0\0\0zstd)(.{6}\0\0)", re.DOTALL
)
# In the statistics: where the number of chunks stands, and those of each channel's messages.
_CHUNK_COUNT = 22
_COUNTS = 46
_MESSAGE_PATTERN = re.compile(rb"\x05(.{5}\0\0\0)", re.DOTALL)
# What may follow a message that is in no chunk.
_FOLLOWING = (SCHEMA, CHANNEL, MESSAGE, ATTACHMENT, METADATA_RECORD, _DATA_END)
# Summary's start, start of its offsets, checksum.
_FOOTER = struct.Struct("<QQI")
_CHECKSUM = struct.Struct("<I")


@dataclasses.dataclass(frozen=True, slots=True)
class Record:
    """Record in a file.

    Attributes
    ----------
    kind : int
    start, end : int
        Position of its content, bytes.
    complete : bool
        Whether the file has all of it.
    """

    kind: int
    start: int
    end: int
    complete: bool = True


@dataclasses.dataclass(frozen=True)
class Channel:
    """Channel of an MCAP file.

    Attributes
    ----------
    topic : str
    schema : ForeignSchema
        Encoding of its messages.
    metadata : bytes
        As they stand in the file.
    """

    topic: str
    schema: ForeignSchema
    metadata: bytes


def records(file: BinaryIO, position: int, end: int) -> Iterator[Record]:
    """Yield the records of a file between two positions.

    Where there are none, because of damage, the next chunk is looked for, or in a file without
    chunks the next message; the gap is told by the records' positions. The last record may be
    incomplete.
    """
    before = position
    chunked = False
    more_chunks = True
    while position + RECORD.size <= end:
        file.seek(position)
        kind, length = RECORD.unpack(file.read(RECORD.size))
        start = position + RECORD.size
        if kind and start + length <= end:
            yield Record(kind, start, start + length)
            chunked |= kind == CHUNK
            before, position = position, start + length
            continue
        # The length of the record before may be what is wrong.
        found = _next_chunk(file, before + 1, end) if more_chunks else None
        # Else every gap would be followed by a search to the end.
        more_chunks = found is not None
        if found is None and not chunked and kind != CHUNK:
            found = _next_message(file, before + 1, end)
        if found is None:
            if kind in (CHUNK, MESSAGE) and length:
                yield Record(kind, start, end, complete=False)
            return
        before = position = found


def _next_chunk(file: BinaryIO, position: int, end: int) -> int | None:
    """Position of the first complete chunk behind another position; None if there is none."""
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        while match := _CHUNK_PATTERN.search(content, position, end):
            (length,) = struct.unpack("<Q", match[1])
            first_ns, last_ns, _, _ = _CHUNK_HEADER.unpack(match[2])
            (packed,) = struct.unpack("<Q", match[4])
            rest = length - (match.end() - match.start() - RECORD.size)
            if packed == rest and first_ns <= last_ns and match.end() + packed <= end:
                return match.start()
            position = match.start() + 1
    return None


def _next_message(file: BinaryIO, position: int, end: int) -> int | None:
    """Position of the first message behind another position that a record follows, or None."""
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        while match := _MESSAGE_PATTERN.search(content, position, end):
            (length,) = struct.unpack("<Q", match[1])
            behind = match.start() + RECORD.size + length
            if length >= MESSAGE_HEADER.size and behind + RECORD.size <= end:
                kind, next_length = RECORD.unpack_from(content, behind)
                fits = behind + RECORD.size + next_length <= end
                if fits and kind in _FOLLOWING:
                    return match.start()
            position = match.start() + 1
    return None


def read_content(file: BinaryIO, record: Record) -> bytes:
    """Content of a record; a `ValueError` if it is larger than any message should be."""
    length = record.end - record.start
    if length > LARGEST_UNPACKED_BYTES:
        raise ValueError(f"a record of {length} bytes, expected at most {LARGEST_UNPACKED_BYTES}")
    file.seek(record.start)
    return file.read(length)


def chunk_facts(file: BinaryIO, chunk: Record) -> tuple[int, int]:
    """Time of the first message of a chunk, ns, and unpacked size, as its header has them."""
    file.seek(chunk.start)
    header = file.read(min(_CHUNK_HEADER.size, chunk.end - chunk.start))
    start_ns, _, size, _ = _CHUNK_HEADER.unpack(header)
    return start_ns, size


def unpack_chunk(file: BinaryIO, chunk: Record) -> tuple[list[tuple[int, memoryview]], int]:
    """Kinds and contents of the records in a chunk, and bytes of it that are damaged.

    Of a chunk that does not fit its checksum nothing is used, unless it breaks off with zeros,
    which file systems fill in for what was never written.
    """
    try:
        # Views: a frame is copied once, when it is read, and once, when it is given out.
        content = memoryview(read_content(file, chunk))
    except ValueError:
        return [], chunk.end - chunk.start
    body = io.BytesIO(content[:_CHUNK_START_BYTES])
    try:
        _, _, size, checksum = _CHUNK_HEADER.unpack(body.read(_CHUNK_HEADER.size))
        compression = read_string(body)
        (packed,) = struct.unpack("<Q", body.read(8))
        raw = content[body.tell() : body.tell() + packed]
        # More than nothing where a length is wrong.
        behind = len(content) - body.tell() - len(raw) if chunk.complete else 0
    except DAMAGE:
        return [], len(content)
    try:
        found, unused = _inner_records(memoryview(unpacked_chunk(raw, compression, size, checksum)))
        return found, unused + behind
    except DAMAGE:
        if compression:
            return [], len(content)
    found, unused = _inner_records(raw)
    if chunk.complete and (not unused or any(raw[len(raw) - unused :])):
        return [], len(content)
    return found, unused + behind


def _inner_records(content: memoryview) -> tuple[list[tuple[int, memoryview]], int]:
    """Kinds and contents of records in a row, and bytes behind the last one."""
    found = []
    position = 0
    while position + RECORD.size <= len(content):
        kind, length = RECORD.unpack_from(content, position)
        end = position + RECORD.size + length
        if not kind or end > len(content):
            break
        found.append((kind, content[position + RECORD.size : end]))
        position = end
    return found, len(content) - position


class Descriptions:
    """Schemas and channels, as they come in a file, in whatever order."""

    def __init__(self) -> None:
        self._schemas: dict[int, tuple[str, str, bytes]] = {}
        self._channels: dict[int, tuple[int, str, str, bytes]] = {}

    def add(self, kind: int, content: bytes | memoryview) -> None:
        """Add what a schema or a channel says; records of other kinds are nothing to add."""
        body = io.BytesIO(content)
        if kind == SCHEMA:
            (number,) = struct.unpack("<H", body.read(2))
            self._schemas[number] = read_string(body), read_string(body), read_bytes(body)
        elif kind == CHANNEL:
            number, schema = struct.unpack("<HH", body.read(4))
            topic, encoding = read_string(body), read_string(body)
            self._channels[number] = schema, topic, encoding, read_bytes(body)

    def channels(self) -> dict[int, Channel]:
        """Channels by their numbers; one whose schema is lost has none."""
        found = {}
        for number, (schema, topic, encoding, metadata) in self._channels.items():
            name, schema_encoding, data = self._schemas.get(schema, ("", "", b""))
            described = ForeignSchema(encoding, name, schema_encoding, data, _pairs(metadata))
            found[number] = Channel(topic, described, metadata)
        return found


def _pairs(content: bytes) -> tuple[tuple[str, str], ...]:
    """Keys and values of a channel's metadata, as far as they can be read."""
    body = io.BytesIO(content)
    found = []
    with suppress(*DAMAGE):
        while body.tell() < len(content):
            found.append((read_string(body), read_string(body)))
    return tuple(found)


def begins_well(file: BinaryIO) -> bool:
    """Whether a file begins like an MCAP file."""
    file.seek(0)
    start = file.read(len(MAGIC) + 1)
    return start == MAGIC + bytes([HEADER])


def summary_start(file: BinaryIO, size: int) -> int | None:
    """Position of the summary at the end of an MCAP file; 0: it has none; None: it has no end."""
    footer = RECORD.pack(FOOTER, _FOOTER.size)
    position = size - len(MAGIC) - _FOOTER.size - len(footer)
    if position < len(MAGIC):
        return None
    file.seek(position)
    end = file.read()
    if not end.startswith(footer) or not end.endswith(MAGIC):
        return None
    start, _, _ = _FOOTER.unpack_from(end, len(footer))
    return start if start <= position else None


def summary_is_whole(file: BinaryIO, size: int) -> bool:
    """Whether the summary at the end of an MCAP file has its checksum, if it has one."""
    start = summary_start(file, size)
    if not start:
        return True
    end = size - len(MAGIC) - _CHECKSUM.size
    file.seek(start)
    content = file.read(end - start)
    (checksum,) = _CHECKSUM.unpack(file.read(_CHECKSUM.size))
    return checksum in (0, zlib.crc32(content))


def read_statistics(content: bytes) -> tuple[int, dict[int, int]]:
    """Number of chunks, and of the messages of each channel, from the content of statistics."""
    (chunks,) = struct.unpack_from("<I", content, _CHUNK_COUNT)
    return chunks, dict(struct.iter_unpack("<HQ", content[_COUNTS:]))


def supplement_name(kind: int, content: bytes) -> str:
    """Name in an attachment or a record of metadata."""
    if kind == ATTACHMENT:
        return attachment_facts(content)[0]
    return read_string(io.BytesIO(content))


def attachment_facts(content: bytes) -> tuple[str, str, int]:
    """Name, media type and size of an attachment."""
    body = io.BytesIO(content)
    body.read(16)  # times of recording and making
    name, media_type = read_string(body), read_string(body)
    (size,) = struct.unpack("<Q", body.read(8))
    return name, media_type, size
