"""Reading of ROS 2 bags, whole or cut off: topics, and messages in order.

rosbags is imported when a bag is opened, and not before.
"""

import dataclasses
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from coded_aperture_ros.bags.contents import METADATA, SUFFIXES, BagMessage, Topic
from coded_aperture_ros.core.errors import InputError


def is_bag(path: str | os.PathLike[str]) -> bool:
    """Whether a path looks like a bag: its folder, whole or cut off, or a file of one."""
    path = Path(path)
    return bool(_storage_files(path)) or (path / METADATA).is_file()


class Bag(AbstractContextManager["Bag"]):
    """Bag that is read from beginning to end, as far as it can be read.

    Parameters
    ----------
    path : str or path
        Folder with `metadata.yaml`, or left without it, or a `.mcap` or `.db3` file.

    Attributes
    ----------
    storage : str
        `mcap` or `sqlite3`.
    topics : dict of str to Topic
        Of the files that can be read, in the order of their names.
    damage : str
        What is wrong with the bag; empty if nothing is, or nothing was met yet.

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
        from coded_aperture_ros.bags.opening import open_parts

        self._parts, damage = open_parts(self.path, _storage_files(self.path))
        self.damage = "; ".join(damage)
        self.storage = self._parts[0].storage
        topics: dict[str, Topic] = {}
        for topic in (topic for part in self._parts for topic in part.topics):
            before = topics.get(topic.name)
            topics[topic.name] = topic if before is None else _joined(before, topic)
        self.topics = dict(sorted(topics.items()))

    def messages(self, *topics: str) -> Iterator[BagMessage]:
        """Yield the messages of topics, by default of all, in the order of their recording.

        They end where the bag is cut off, and `damage` says so.
        """
        from coded_aperture_ros.bags.complete import DAMAGE, one_line

        for part in self._parts:
            try:
                yield from part.messages(topics or tuple(self.topics))
                met = part.damage
            except DAMAGE as error:
                met = f"{part.path.name} is damaged: {one_line(error)}"
            if met not in self.damage:
                self.damage = f"{self.damage}; {met}" if self.damage else met

    def close(self) -> None:
        """Close the files."""
        for part in self._parts:
            part.close()

    def __exit__(self, *_: object) -> None:
        self.close()


def check_rosbags() -> None:
    """Raise `InputError` if rosbags is not installed."""
    try:
        import rosbags.rosbag2  # noqa: F401
    except ImportError as error:
        raise InputError("bags need rosbags: pip install rosbags") from error


def _joined(one: Topic, other: Topic) -> Topic:
    """Topic whose messages are in two files."""
    known = one.count is not None and other.count is not None
    return dataclasses.replace(one, count=(one.count or 0) + (other.count or 0) if known else None)


def _storage_files(path: Path) -> list[Path]:
    """Files of a bag: those of the storage that comes first in `SUFFIXES`."""
    files = list(path.iterdir()) if path.is_dir() else [path] if path.is_file() else []
    for suffix in SUFFIXES:
        if found := [file for file in files if file.suffix.lower() == suffix]:
            return found
    return []
