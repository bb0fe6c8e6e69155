"""MCAP files that were cut off: messages before the cut.

An MCAP file is a row of records, each with its kind and length (https://mcap.dev/spec); the index
at its end is for convenience. rosbags knows what is in a record, but wants a whole file. The
package `mcap` reads streams, but gives out a message that was cut in the middle, and jumps over
holes, both without a word.
"""

import dataclasses
import io
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

from rosbags.rosbag2.storage_mcap import decompress, get_qos, read_bytes, read_string

from coded_aperture_ros.bags.complete import DAMAGE
from coded_aperture_ros.bags.contents import BagMessage, Topic

_MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
_SCHEMA = 0x03
_CHANNEL = 0x04
_MESSAGE = 0x05
_CHUNK = 0x06
# The footer, the end of the data, and a hole in the file, filled with zeros.
_ENDS = (0x02, 0x0F, 0x00)
# Channel, number in the sequence, times of recording and sending; the data follows.
_MESSAGE_HEADER = struct.Struct("<HIQQ")
# Start and end time, size and checksum; compression, length of the records and these follow.
_CHUNK_HEADER = struct.Struct("<QQQI")


class CutMcap:
    """MCAP file that was cut off, as a `Part` of a bag; one of `DAMAGE` if it begins badly."""

    storage = "mcap"

    def __init__(self, path: Path) -> None:
        self.path = path
        schemas: dict[int, tuple[str, str]] = {}
        topics: dict[int, Topic] = {}
        counts: Counter[int] = Counter()
        used = 0
        for kind, content, end in _records_of(path):
            used = end
            body = io.BytesIO(content)
            if kind == _SCHEMA:
                (number,) = struct.unpack("<H", body.read(2))
                name = read_string(body)
                read_string(body)  # encoding of the definition
                definition = read_string(body)
                schemas[number] = name, definition
            elif kind == _CHANNEL:
                number, schema = struct.unpack("<HH", body.read(4))
                name = read_string(body)
                read_string(body)  # encoding of the messages
                metadata = read_bytes(body)
                topics[number] = Topic(name, *schemas[schema], qos=tuple(get_qos(metadata)))
            elif kind == _MESSAGE:
                counts[_MESSAGE_HEADER.unpack_from(content)[0]] += 1
        self.topics = [
            dataclasses.replace(topic, count=counts[number]) for number, topic in topics.items()
        ]
        self._names = {number: topic.name for number, topic in topics.items()}
        lost = path.stat().st_size - used
        self.damage = f"{path.name} is cut off" + (
            f", its last {lost} bytes cannot be used" if lost else ", it has no end"
        )

    def messages(self, topics: Sequence[str]) -> Iterator[BagMessage]:
        """Yield messages as they stand in the file."""
        for kind, content, _ in _records_of(self.path):
            if kind == _MESSAGE:
                number, _, time_ns, _ = _MESSAGE_HEADER.unpack_from(content)
                if self._names[number] in topics:
                    yield BagMessage(self._names[number], time_ns, content[_MESSAGE_HEADER.size :])

    def close(self) -> None:
        """Do nothing: no file is open between two readings."""


def _records_of(path: Path) -> Iterator[tuple[int, bytes, int]]:
    """Yield complete records, those of chunks one by one: kind, content, bytes used so far."""
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError("it does not begin like an MCAP file")
        for kind, content, complete in _row(file):
            if kind != _CHUNK:
                if complete:
                    yield kind, content, file.tell()
                continue
            records, complete = _unpacked(content, complete)
            chunk = io.BytesIO(records)
            done = 0
            for inner_kind, inner, inner_complete in _row(chunk):
                if inner_complete:
                    done = chunk.tell()
                    # Of a chunk that is not complete, the records are what the file ends with.
                    unused = 0 if complete else len(records) - done
                    yield inner_kind, inner, file.tell() - unused
            if not complete or done < len(records):
                return


def _row(file: IO[bytes]) -> Iterator[tuple[int, bytes, bool]]:
    """Yield kind and content of records, and whether all of it is there, up to an end or a hole."""
    while len(header := file.read(_RECORD.size)) == _RECORD.size:
        kind, length = _RECORD.unpack(header)
        if kind in _ENDS:
            return
        content = file.read(length)
        yield kind, content, len(content) == length


def _unpacked(chunk: bytes, complete: bool) -> tuple[bytes, bool]:
    """Records of a chunk; of a damaged one, those that are not compressed."""
    compression = None
    records = b""
    body = io.BytesIO(chunk)
    try:
        _, _, size, checksum = _CHUNK_HEADER.unpack(body.read(_CHUNK_HEADER.size))
        compression = read_string(body)
        records = body.read()[8:]
        return decompress(records, compression, size, checksum), complete
    except DAMAGE:
        return b"" if compression else records, False
