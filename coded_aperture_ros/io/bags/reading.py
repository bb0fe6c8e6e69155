"""Recorded ROS 2 bags, whole or cut off: their topics, and their messages in order.

Needs rosbags, which is imported only here and in the modules beside, and only when a bag is opened.
"""

import dataclasses
import os
import re
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from coded_aperture_ros.core.errors import InputError

SUFFIXES = {".mcap": "mcap", ".db3": "sqlite3"}
METADATA = "metadata.yaml"


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes
    ----------
    name : str
    type_name : str
        As `sensor_msgs/msg/Image`.
    definition : str
        Of the message type, with those of the types in it; empty if the bag does not have it.
    type_hash : str
        `RIHS01_...`; empty if the bag does not have it.
    qos : tuple
        Profiles that were offered, as rosbags represents them.
    count : int or None
        Messages, if that is known.
    """

    name: str
    type_name: str
    definition: str = ""
    type_hash: str = ""
    qos: tuple[Any, ...] = ()
    count: int | None = None


@dataclasses.dataclass(frozen=True)
class Recorded:
    """One message of a bag.

    Attributes
    ----------
    topic : str
    time_ns : int
        When it was recorded.
    data : bytes
        As it was sent (CDR).
    """

    topic: str
    time_ns: int
    data: bytes


def is_bag(path: str | os.PathLike[str]) -> bool:
    """Return whether a path looks like a bag: its folder, whole or cut off, or a file of one."""
    path = Path(path)
    if path.is_dir():
        return (path / METADATA).is_file() or bool(_storage_files(path))
    return path.suffix.lower() in SUFFIXES and path.is_file()


class Bag:
    """A bag that is read from beginning to end, as far as it can be read.

    Parameters
    ----------
    path : path-like
        A folder with `metadata.yaml`, one that was left without it, or a `.mcap` or `.db3` file.

    Attributes
    ----------
    path : pathlib.Path
    storage : str
        `mcap` or `sqlite3`.
    topics : dict of str to Topic
        In the order of their names. Those of the files that can be read.
    damage : str
        What is wrong with the bag, in words; empty if nothing is, or nothing was met yet.

    Raises
    ------
    InputError
        If there is no bag, or nothing in it can be read.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() == ".bag":
            raise InputError(
                f"{self.path}: a bag of ROS 1, make one of ROS 2 from it: "
                f"rosbags-convert --src {self.path} --dst {self.path.stem}"
            )
        if not self.path.exists():
            raise InputError(f"cannot read {self.path}: no such file or folder")
        if not is_bag(self.path):
            raise InputError(
                f"{self.path}: no bag: expected a folder with {METADATA}, or a .mcap or .db3 file"
            )
        check_rosbags()
        self.damage = ""
        self._parts = self._open()
        self.storage = self._parts[0].storage
        self.topics: dict[str, Topic] = {}
        for part in self._parts:
            for topic in part.topics:
                before = self.topics.setdefault(topic.name, topic)
                if before is not topic:
                    self.topics[topic.name] = _joined(before, topic)
        self.topics = dict(sorted(self.topics.items()))

    def messages(self, *topics: str) -> Iterator[Recorded]:
        """Yield the messages of some topics, by default of all.

        In the order of their recording; behind a cut nothing comes, and `damage` says so.
        """
        from coded_aperture_ros.io.bags.whole import DAMAGE

        for part in self._parts:
            try:
                yield from part.messages(topics or tuple(self.topics))
            except DAMAGE as error:
                self._damaged(f"{part.path.name} is damaged: {_in_a_line(error)}")
            if part.damage:
                self._damaged(part.damage)

    def close(self) -> None:
        """Close the files."""
        for part in self._parts:
            part.close()

    def __enter__(self) -> "Bag":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _damaged(self, what: str) -> None:
        if what not in self.damage:
            self.damage = f"{self.damage}; {what}" if self.damage else what

    def _open(self) -> "list[Any]":
        from coded_aperture_ros.io.bags.whole import DAMAGE, WholeBag

        refused = ""
        if self.path.is_file() or (self.path / METADATA).is_file():
            try:
                return [WholeBag(self.path)]
            except PermissionError as error:
                raise InputError(f"cannot read {self.path}: {error.strerror}") from error
            except DAMAGE as error:
                refused = _in_a_line(error)
        files = [self.path] if self.path.is_file() else _storage_files(self.path)
        if not refused:
            self._damaged(f"it has no {METADATA}, as if the recording was cut off")
        elif self.path.is_dir():
            self._damaged(f"it cannot be opened as a whole ({refused})")
        return self._open_one_by_one(files, refused)

    def _open_one_by_one(self, files: list[Path], refused: str) -> "list[Any]":
        """Open the files of a bag, each as a whole or as far as it goes."""
        from coded_aperture_ros.io.bags.cut_mcap import CutMcap
        from coded_aperture_ros.io.bags.cut_sqlite import CutSqlite
        from coded_aperture_ros.io.bags.whole import DAMAGE, WholeBag

        parts: list[Any] = []
        cut = {".mcap": CutMcap, ".db3": CutSqlite}
        for file in files:
            for kind in (WholeBag, cut[file.suffix.lower()]):
                try:
                    parts.append(kind(file))
                    break
                except DAMAGE as error:
                    refused = f"{file.name}: {_in_a_line(error)}"
            else:
                self._damaged(f"{file.name} cannot be read")
        if not any(part.topics for part in parts):
            for part in parts:
                part.close()
            raise InputError(f"cannot read {self.path}: nothing in it can be read ({refused})")
        for part in parts:
            if part.damage:
                self._damaged(part.damage)
        return parts


def check_rosbags() -> None:
    """Refuse to go on without rosbags.

    Raises
    ------
    InputError
        Saying what to install.
    """
    try:
        import rosbags.rosbag2  # noqa: F401
    except ImportError as error:
        raise InputError("bags need rosbags: pip install rosbags") from error


def _joined(one: Topic, other: Topic) -> Topic:
    """Return a topic whose messages are in two files."""
    counts = one.count, other.count
    count = None if None in counts else sum(count or 0 for count in counts)
    return dataclasses.replace(one, count=count)


def _storage_files(folder: Path) -> list[Path]:
    """Return the files of a bag's folder, those of the storage that comes first, in order."""
    for suffix in SUFFIXES:
        files = [path for path in folder.iterdir() if path.suffix.lower() == suffix]
        if files:
            return sorted(files, key=_by_number)
    return []


def _by_number(path: Path) -> list[Any]:
    """Sort key with which file 10 comes after file 9."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]


def _in_a_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
