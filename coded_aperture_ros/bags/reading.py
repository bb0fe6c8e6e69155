"""Recorded ROS 2 bags, whole or cut off: their topics, and their messages in order.

rosbags, which the modules beside need, is imported when a bag is opened, and not before.
"""

import dataclasses
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from coded_aperture_ros.bags.recorded import METADATA, SUFFIXES, Recorded, Topic
from coded_aperture_ros.core.errors import InputError


def is_bag(path: str | os.PathLike[str]) -> bool:
    """Return whether a path looks like a bag: its folder, whole or cut off, or a file of one."""
    path = Path(path)
    return bool(_storage_files(path)) or (path / METADATA).is_file()


class Bag(AbstractContextManager["Bag"]):
    """A bag that is read from beginning to end, as far as it can be read.

    A folder with `metadata.yaml`, one that was left without it, or a `.mcap` or `.db3` file. Raises
    `InputError` if there is no bag, or nothing in it can be read.

    `storage` is `mcap` or `sqlite3`; `topics` are those of the files that can be read, in the order
    of their names; `damage` is what is wrong with the bag, in words; empty if nothing is, or
    nothing was met yet.
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
        from coded_aperture_ros.bags.opening import open_parts

        self._parts, damage = open_parts(self.path, _storage_files(self.path))
        self.damage = "; ".join(damage)
        self.storage = self._parts[0].storage
        topics: dict[str, Topic] = {}
        for topic in (topic for part in self._parts for topic in part.topics):
            before = topics.get(topic.name)
            topics[topic.name] = topic if before is None else _joined(before, topic)
        self.topics = dict(sorted(topics.items()))

    def messages(self, *topics: str) -> Iterator[Recorded]:
        """Yield the messages of some topics, by default of all.

        In the order of their recording; behind a cut nothing comes, and `damage` says so.
        """
        from coded_aperture_ros.bags.complete import DAMAGE, in_a_line

        for part in self._parts:
            try:
                yield from part.messages(topics or tuple(self.topics))
                met = part.damage
            except DAMAGE as error:
                met = f"{part.path.name} is damaged: {in_a_line(error)}"
            if met not in self.damage:
                self.damage = f"{self.damage}; {met}" if self.damage else met

    def close(self) -> None:
        """Close the files."""
        for part in self._parts:
            part.close()

    def __exit__(self, *_: object) -> None:
        self.close()


def check_rosbags() -> None:
    """Refuse to go on without rosbags, with an `InputError` that says what to install."""
    try:
        import rosbags.rosbag2  # noqa: F401
    except ImportError as error:
        raise InputError("bags need rosbags: pip install rosbags") from error


def _joined(one: Topic, other: Topic) -> Topic:
    """Return a topic whose messages are in two files."""
    known = one.count is not None and other.count is not None
    return dataclasses.replace(one, count=(one.count or 0) + (other.count or 0) if known else None)


def _storage_files(path: Path) -> list[Path]:
    """Return the files that a bag is made of: those of the storage that comes first."""
    files = list(path.iterdir()) if path.is_dir() else [path] if path.is_file() else []
    for suffix in SUFFIXES:
        if found := [file for file in files if file.suffix.lower() == suffix]:
            return found
    return []
