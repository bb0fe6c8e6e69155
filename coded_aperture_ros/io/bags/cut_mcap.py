"""MCAP files without an end: what was written before a recording was cut off.

An MCAP file is a row of records, each with its length (https://mcap.dev/spec); the index at its end
is for convenience. So the records that are complete, followed by an empty index, are a file again.
"""

import io
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

from rosbags.rosbag2.storage_mcap import McapReader, decompress

from coded_aperture_ros.io.bags.reading import Recorded
from coded_aperture_ros.io.bags.whole import DAMAGE, topic_of

_MAGIC = b"\x89MCAP0\r\n"
_HEADER = struct.Struct("<BQ")
_FOOTER, _CHUNK, _DATA_END = 0x02, 0x06, 0x0F
_NOTHING = 0x00  # not a kind of record: a hole in the file
_END = (
    _HEADER.pack(_DATA_END, 4)
    + bytes(4)
    + _HEADER.pack(_FOOTER, 20)
    + bytes(20)  # no index
    + _MAGIC
)
# Start and end time, size and checksum; compression, length of the records and these follow.
_CHUNK_HEADER = struct.Struct("<QQQI")


class CutMcap:
    """See `Bag`, whose parts are of this kind where an MCAP file was cut off.

    Raises
    ------
    rosbags.rosbag2.ReaderError
        Or another error, if it does not even begin well.
    """

    storage = "mcap"

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            complete, rest = complete_records(path)
            self._reader = _opened(path, complete, rest)
        except DAMAGE:
            # What has the right length may have a hole, filled with zeros, in it.
            complete, rest = complete_records(path, check=True)
            self._reader = _opened(path, complete, rest)
        self.topics = [topic_of(connection) for connection in self._reader.connections]
        lost = path.stat().st_size - complete - len(rest)
        self.damage = f"{path.name} is cut off" + (
            f", its last {lost} bytes cannot be used" if lost else ", it has no end"
        )

    def messages(self, topics: Sequence[str]) -> Iterator[Recorded]:
        """Yield messages as they stand in the file."""
        wanted = [one for one in self._reader.connections if one.topic in topics]
        for connection, time_ns, data in self._reader.messages_scan(wanted):
            yield Recorded(connection.topic, time_ns, data)

    def close(self) -> None:
        """Close the file."""
        self._reader.close()


def complete_records(path: Path, check: bool = False) -> tuple[int, bytes]:
    """Find what is complete in an MCAP file.

    Parameters
    ----------
    path : pathlib.Path
    check : bool, optional
        Look into the chunks too, which takes as long as reading the file.

    Returns
    -------
    complete : int
        So many bytes from the beginning are complete records, an index at the end left out.
    rest : bytes
        The complete records inside of a chunk that is not; only an uncompressed one has any.

    Raises
    ------
    ValueError
        If it does not begin like an MCAP file.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError("it does not begin like an MCAP file")
        complete = file.tell()
        while len(header := file.read(_HEADER.size)) == _HEADER.size:
            kind, length = _HEADER.unpack(header)
            end = complete + _HEADER.size + length
            if kind in (_DATA_END, _FOOTER):
                break
            if kind == _NOTHING or end > size:  # or cut off in the middle
                return complete, _records_in(file.read()) if kind == _CHUNK else b""
            if check and kind == _CHUNK and not _is_whole(body := file.read(length)):
                return complete, _records_in(body)
            complete = end
            file.seek(complete)
    return complete, b""


def _opened(path: Path, complete: int, rest: bytes) -> McapReader:
    reader = McapReader(_Mended(path, complete, rest + _END))
    reader.open()
    return reader


def _is_whole(chunk: bytes) -> bool:
    """Return whether a chunk has nothing but complete records in it."""
    _, _, size, checksum = _CHUNK_HEADER.unpack_from(chunk)
    (name_length,) = struct.unpack_from("<I", chunk, _CHUNK_HEADER.size)
    start = _CHUNK_HEADER.size + 4 + name_length
    try:
        compression = chunk[_CHUNK_HEADER.size + 4 : start].decode()
        records = decompress(chunk[start + 8 :], compression, size, checksum)
    except DAMAGE:
        return False
    return _complete_length(records) == len(records)


def _records_in(chunk: bytes) -> bytes:
    """Return the complete records at the beginning of an uncompressed chunk."""
    start = _CHUNK_HEADER.size + 4 + 8  # without the name of a compression
    if len(chunk) < start or struct.unpack_from("<I", chunk, _CHUNK_HEADER.size) != (0,):
        return b""
    records = chunk[start:]
    return records[: _complete_length(records)]


def _complete_length(records: bytes) -> int:
    """Return how many bytes of a row of records are complete ones."""
    complete = 0
    while complete + _HEADER.size <= len(records):
        kind, length = _HEADER.unpack_from(records, complete)
        end = complete + _HEADER.size + length
        if kind == _NOTHING or end > len(records):
            break
        complete = end
    return complete


class _Mended:
    """Stands in for the path of a file: its beginning, followed by other bytes."""

    def __init__(self, path: Path, length: int, end: bytes) -> None:
        self._path, self._length, self._end = path, length, end

    def open(self, mode: str) -> io.BufferedReader:
        """Open it for reading; `mode` is rb."""
        return io.BufferedReader(_Joined(self._path.open("rb"), self._length, self._end))

    def __str__(self) -> str:
        return str(self._path)


class _Joined(io.RawIOBase):
    """The first bytes of a file, followed by other bytes."""

    def __init__(self, file: IO[bytes], length: int, end: bytes) -> None:
        self._file, self._length, self._end = file, length, end
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {
            io.SEEK_SET: 0,
            io.SEEK_CUR: self._at,
            io.SEEK_END: self._length + len(self._end),
        }[whence]
        self._at = base + offset
        return self._at

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        if self._at < self._length:
            self._file.seek(self._at)
            data = self._file.read(min(len(buffer), self._length - self._at))
        else:
            start = self._at - self._length
            data = self._end[start : start + len(buffer)]
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()
