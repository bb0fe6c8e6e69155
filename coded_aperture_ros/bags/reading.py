"""Reading of ROS 2 bags, whole or cut off: topics, and messages in order.

rosbags is imported when a bag is opened, and not before.
"""

import dataclasses
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

from coded_aperture_ros.bags.contents import BagMessage, Supplement, Topic
from coded_aperture_ros.bags.names import METADATA, is_bag
from coded_aperture_ros.core.errors import InputError


class Bag(AbstractContextManager["Bag"]):
    """Bag that is read from beginning to end, as far as it can be read.

    Parameters
    ----------
    path : str or path
        Folder with `metadata.yaml`, or left without it, or a `.mcap` or `.db3` file, which may be
        compressed (`.zstd`).

    Attributes
    ----------
    storage : str
        `mcap` or `sqlite3`.
    topics : dict of str to Topic
        Of the files that can be read, in the order of their names; also those of other programs.
    left_out : list of Topic
        Those that have the name of another one, and other messages.

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

        self._resources = ExitStack()
        with self._resources:
            self._parts, self._damage, layout = open_parts(self.path, self._resources)
            self._packed = layout.packed_messages
            self._lost = 0
            self.storage = self._parts[0].storage
            self.topics, self.left_out = self._joined(layout.type_hashes)
            self._check_ros_2()
            self._resources = self._resources.pop_all()

    def messages(self, *topics: str) -> Iterator[BagMessage]:
        """Yield the messages of topics, by default of all, in the order of their recording.

        They end where the bag is cut off, and `damage` says so.
        """
        wanted = {
            name: topic.type_name
            for name, topic in self.topics.items()
            if not topics or name in topics
        }
        for part in self._parts:
            messages = part.messages(wanted)
            yield from self._unpacked(messages) if self._packed else messages

    def supplements(self) -> Iterator[Supplement]:
        """Yield what the files hold beside messages: attachments, and metadata of programs."""
        for part in self._parts:
            yield from part.supplements()

    @property
    def damage(self) -> str:
        """What is wrong with the bag, as far as it was read; empty if nothing is."""
        lost = [f"{self._lost} messages cannot be unpacked"] if self._lost else []
        return "; ".join(
            [*self._damage, *(part.damage for part in self._parts if part.damage), *lost]
        )

    def close(self) -> None:
        """Close the files, and remove copies of them."""
        self._resources.close()

    def _joined(self, type_hashes: Mapping[str, str]) -> tuple[dict[str, Topic], list[Topic]]:
        """Topics of all files by their names, those of ROS 2 first, and others of their names."""
        topics: dict[str, Topic] = {}
        others = []
        every = [topic for part in self._parts for topic in part.topics]
        for topic in sorted(every, key=lambda topic: topic.foreign is not None):
            before = topics.get(topic.name)
            if before is None:
                type_hash = topic.type_hash or type_hashes.get(topic.name, "")
                topics[topic.name] = dataclasses.replace(topic, type_hash=type_hash)
            elif before.type_name == topic.type_name:
                topics[topic.name] = _sum(before, topic)
            elif topic.count != 0:
                others.append(topic)
        return dict(sorted(topics.items())), others

    def _check_ros_2(self) -> None:
        """Raise `InputError` if all messages are of ROS 1."""
        encodings = {
            topic.foreign.message_encoding for topic in self.topics.values() if topic.foreign
        }
        if "ros1" in encodings and all(topic.foreign for topic in self.topics.values()):
            raise InputError(
                f"{self.path}: messages of ROS 1, make a bag of ROS 2 from the .bag file that they "
                "come from: rosbags-convert --src FILE.bag --dst FOLDER"
            )

    def _unpacked(self, messages: Iterable[BagMessage]) -> Iterator[BagMessage]:
        """Yield messages that were compressed one by one."""
        from coded_aperture_ros.bags.compression import (
            LARGEST_UNPACKED_BYTES,
            most_unpacked,
            unpacked,
        )
        from coded_aperture_ros.bags.damage import DAMAGE

        left = most_unpacked(self._size())
        for message in messages:
            try:
                data = unpacked(message.data, "zstd", min(left, LARGEST_UNPACKED_BYTES))
            except DAMAGE:
                self._lost += 1
                continue
            left -= len(data)
            yield dataclasses.replace(message, data=data)

    def _size(self) -> int:
        """Bytes of all files."""
        return sum(part.path.stat().st_size for part in self._parts)

    def __exit__(self, *_: object) -> None:
        self.close()


def check_rosbags() -> None:
    """Raise `InputError` if rosbags is not installed."""
    try:
        import rosbags.rosbag2  # noqa: F401
    except ImportError as error:
        raise InputError("bags need rosbags: pip install rosbags") from error


def _sum(one: Topic, other: Topic) -> Topic:
    """Topic whose messages are in two files."""
    known = one.count is not None and other.count is not None
    return dataclasses.replace(
        one,
        definition=one.definition or other.definition,
        count=(one.count or 0) + (other.count or 0) if known else None,
    )
