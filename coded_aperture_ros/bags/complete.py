"""Undamaged bags, or files of bags, by rosbags; and what it raises if there is damage."""

import sqlite3
import struct
import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader, ReaderError

from coded_aperture_ros.bags.contents import SUFFIXES, BagMessage, Topic

# What rosbags itself depends on.
_apsw: Any = import_module("apsw")
_zstd: Any = import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")

# What rosbags raises for files that a computer left behind when it lost its power.
DAMAGE: tuple[type[BaseException], ...] = (
    ReaderError,
    OSError,
    sqlite3.Error,
    _apsw.Error,
    struct.error,
    _zstd.ZstdError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    EOFError,
    AssertionError,
    RuntimeError,
)


def one_line(error: BaseException) -> str:
    """Message of an error in one line, or else its name."""
    return " ".join(str(error).split()) or type(error).__name__


class CompleteBag:
    """Undamaged bag or file of one, as a `Part`; raises one of `DAMAGE` if it is damaged."""

    damage = ""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._reader = Reader(path)
        self._reader.open()
        self.topics = [topic_from_connection(connection) for connection in self._reader.connections]
        self.storage = storage_format(path)

    def messages(self, topics: Sequence[str]) -> Iterator[BagMessage]:
        """Yield messages in the order of their recording."""
        wanted = [one for one in self._reader.connections if one.topic in topics]
        if not wanted:  # which would mean all of them
            return
        for connection, time_ns, data in self._reader.messages(wanted):
            yield BagMessage(connection.topic, time_ns, data)

    def close(self) -> None:
        """Close the files."""
        self._reader.close()


def topic_from_connection(connection: Any) -> Topic:
    """Topic of a connection of rosbags."""
    return Topic(
        connection.topic,
        connection.msgtype,
        connection.msgdef.data,
        connection.digest,
        tuple(connection.ext.offered_qos_profiles),
        connection.msgcount,
    )


def storage_format(path: Path) -> str:
    """Storage of a bag, `mcap` or `sqlite3`, by the names of its files."""
    files = path.iterdir() if path.is_dir() else [path]
    # With compression: bag_0.db3.zstd.
    suffixes = {suffix for file in files for suffix in file.suffixes}
    return next((kind for suffix, kind in SUFFIXES.items() if suffix in suffixes), "mcap")
