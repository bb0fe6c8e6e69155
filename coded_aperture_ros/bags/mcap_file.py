"""MCAP files: complete, cut off, or damaged in the middle, and with channels of any program."""

import heapq
import os
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from operator import itemgetter
from pathlib import Path

import numpy as np
from rosbags.rosbag2.storage_mcap import get_qos

from coded_aperture_ros.bags import mcap_records as mcap
from coded_aperture_ros.bags.compression import LARGEST_UNPACKED_BYTES, most_unpacked
from coded_aperture_ros.bags.contents import MOST_TOPICS, BagMessage, Supplement, Topic
from coded_aperture_ros.bags.damage import DAMAGE

_ROS_SCHEMAS = ("ros2msg", "ros2idl", "")
_NAMES = {mcap.ATTACHMENT: "attachment", mcap.METADATA_RECORD: "metadata"}
# Records of other kinds, but for those from 0x80, which are private, are damage.
_KINDS = 0x0F
_PRIVATE = 0x80
# What rosbag2 writes for itself.
_OF_ROSBAG2 = "rosbag2"


class McapFile:
    """MCAP file, as a part of a bag; one of `DAMAGE` if there is nothing of one.

    Attributes
    ----------
    topics : list of Topic
    """

    storage = "mcap"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("rb")
        self._descriptions = mcap.Descriptions()
        self._chunks: list[mcap.Record] = []
        self._starts_ns: dict[int, int] = {}
        # What chunks unpack to, and what all of them may.
        self._sizes: dict[int, int] = {}
        self._unpacked_left = most_unpacked(path.stat().st_size)
        self._supplements: list[mcap.Record] = []
        # Messages that are in no chunk: channel, time, position of their content and its end.
        self._single: list[array[int]] = [array("Q") for _ in range(4)]
        self._damaged: set[int] = set()
        self._misplaced: set[int] = set()
        self._missing = 0
        self._gaps = 0
        try:
            self._read()
        except DAMAGE:
            self.close()
            raise

    def messages(self, wanted: Mapping[str, str]) -> Iterator[BagMessage]:
        """Yield messages in the order of their recording, of topics with their types."""
        names = {
            number: topic.name
            for number, topic in self._topics.items()
            if wanted.get(topic.name) == topic.type_name
        }
        opened: Counter[str] = Counter()
        streams = [self._chunk_messages(chunk, names, opened) for chunk in self._chunks]
        for time_ns, message in heapq.merge(*streams, self._singles(names), key=itemgetter(0)):
            if message is not None:
                yield BagMessage(message[0], time_ns, message[1])

    def supplements(self) -> Iterator[Supplement]:
        """Yield attachments and records of metadata, but for rosbag2's own."""
        for record in self._supplements:
            try:
                content = mcap.read_content(self._file, record)
                name = mcap.supplement_name(record.kind, content)
            except DAMAGE:
                self._damaged.add(record.start)
                continue
            if (record.kind, name) != (mcap.METADATA_RECORD, _OF_ROSBAG2):
                yield Supplement(_NAMES[record.kind], name, content)

    @property
    def damage(self) -> str:
        """What is wrong with the file, as far as it was read."""
        found = []
        if self._damaged:
            found.append(f"{len(self._damaged)} of its {len(self._chunks)} chunks are damaged")
        if self._missing:
            found.append(f"{self._missing} of its chunks cannot be found")
        if self._gaps:
            found.append(f"{self._gaps} bytes between its records are damaged")
        if self._undescribed:
            found.append(f"{self._undescribed} messages are of channels that it does not describe")
        parts = [f"{self.path.name}: {', '.join(found)}, and left out"] if found else []
        if not self._summary_is_whole:
            parts.append(f"{self.path.name}: its summary is damaged, and not used")
        if self._misplaced:
            chunks = f"{len(self._misplaced)} of its {len(self._chunks)} chunks"
            parts.append(f"{self.path.name}: {chunks} say a wrong time, and may come too late")
        if self._cut:
            parts.append(f"{self.path.name} is cut off{self._cut}")
        return "; ".join(parts)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read(self) -> None:
        """Go through the records, and unless the file has an index, through those of chunks."""
        size = os.fstat(self._file.fileno()).st_size
        counted: tuple[int, dict[int, int]] | None = None
        begins_well = mcap.begins_well(self._file)
        used = position = len(mcap.MAGIC) if begins_well else 0
        summary = mcap.summary_start(self._file, size)
        self._summary_is_whole = mcap.summary_is_whole(self._file, size)
        for record in mcap.records(self._file, position, size):
            # Less than 0 where a length was wrong, and leads beyond the next record.
            self._gaps += abs(record.start - mcap.RECORD.size - position)
            position = record.end
            if record.kind == mcap.FOOTER:
                used = size
                break
            if summary and record.start > summary and not self._summary_is_whole:
                continue  # chunks describe their channels themselves
            try:
                if record.kind == mcap.STATISTICS:
                    counted = mcap.read_statistics(mcap.read_content(self._file, record))
                used = max(used, self._take(record))
            except DAMAGE:
                self._gaps += record.end - record.start
        else:
            if summary is not None:  # it has an end, not reached
                self._gaps += size - position
        if not (begins_well or self._chunks):
            raise ValueError("it does not begin like an MCAP file")
        counts = Counter(self._single[0])
        channels = self._descriptions.channels()
        if counted is not None and not self._gaps:
            self._missing = max(0, counted[0] - len(self._chunks))
        known = counted is not None and counted[0] == len(self._chunks) and not self._gaps
        if counted is not None and known and channels.keys() >= counted[1].keys():
            counts |= Counter(counted[1])  # what is damaged was not counted there
        else:
            used = max(used, self._scan(counts))
            channels = self._descriptions.channels()
        if len(channels) > MOST_TOPICS:
            raise ValueError(f"it has more than {MOST_TOPICS} topics")
        self._topics = {
            number: topic_from_channel(channel, counts[number])
            for number, channel in channels.items()
        }
        self.topics = list(self._topics.values())
        self._undescribed = sum(n for number, n in counts.items() if number not in channels)
        self._cut = ""
        if summary is None:
            lost = size - used
            self._cut = f", its last {lost} bytes cannot be used" if lost else ", it has no end"

    def _take(self, record: mcap.Record) -> int:
        """Note a record that is in no chunk; return where what can be used of it ends."""
        if record.kind == mcap.CHUNK:
            start_ns, size = mcap.chunk_facts(self._file, record)
            self._chunks.append(record)
            self._starts_ns[record.start] = start_ns
            # One that is too large by itself is damaged, and is not unpacked.
            self._unpacked_left -= size if size <= LARGEST_UNPACKED_BYTES else 0
            if self._unpacked_left < 0:
                self._damaged.add(record.start)
                size = 0
            self._sizes[record.start] = size
            return 0  # until it was read
        if not record.complete:
            return 0
        if record.kind == mcap.MESSAGE:
            header = mcap.read_content(
                self._file, mcap.Record(0, record.start, record.start + mcap.MESSAGE_HEADER.size)
            )
            channel, _, time_ns, _ = mcap.MESSAGE_HEADER.unpack(header)
            values = channel, time_ns, record.start + len(header), record.end
            for column, value in zip(self._single, values, strict=True):
                column.append(value)
        elif record.kind in (mcap.SCHEMA, mcap.CHANNEL):
            self._descriptions.add(record.kind, mcap.read_content(self._file, record))
        elif record.kind in _NAMES:
            self._supplements.append(record)
        elif _KINDS < record.kind < _PRIVATE:
            self._gaps += record.end - record.start
        return record.end

    def _scan(self, counts: Counter[int]) -> int:
        """Read all chunks for their descriptions and counts; return the end of what is usable."""
        used = 0
        for chunk in self._chunks:
            found, unused = self._unpack(chunk)
            for kind, content in found:
                if kind == mcap.MESSAGE:
                    counts[mcap.MESSAGE_HEADER.unpack_from(content)[0]] += 1
                else:
                    with suppress(*DAMAGE):
                        self._descriptions.add(kind, content)
            if unused and chunk.complete:
                self._damaged.add(chunk.start)
            if found:
                used = chunk.end - unused
        return used

    def _chunk_messages(
        self, chunk: mcap.Record, names: Mapping[int, str], opened: Counter[str]
    ) -> Iterator[tuple[int, tuple[str, bytes] | None]]:
        """Yield the start of a chunk, before it is read, and then its messages.

        `opened` counts the bytes of all chunks that are read and not yet at their end: those that
        overlap in time.
        """
        yield self._starts_ns[chunk.start], None
        size = self._sizes[chunk.start]
        if opened["bytes"] + size > LARGEST_UNPACKED_BYTES:
            self._damaged.add(chunk.start)
            return
        opened["bytes"] += size
        found, unused = self._unpack(chunk)
        if unused and chunk.complete:
            self._damaged.add(chunk.start)
        messages = []
        for kind, content in found:
            if kind == mcap.MESSAGE:
                channel, _, time_ns, _ = mcap.MESSAGE_HEADER.unpack_from(content)
                if time_ns < self._starts_ns[chunk.start]:
                    self._misplaced.add(chunk.start)
                if channel in names:
                    data = bytes(content[mcap.MESSAGE_HEADER.size :])
                    messages.append((time_ns, (names[channel], data)))
        del found
        messages.sort(key=itemgetter(0))
        yield from messages
        opened["bytes"] -= size

    def _unpack(self, chunk: mcap.Record) -> tuple[list[tuple[int, memoryview]], int]:
        """Records of a chunk, and bytes that are damaged: all where the file would grow too far."""
        if self._sizes[chunk.start] == 0:
            return [], chunk.end - chunk.start
        found, unused = mcap.unpack_chunk(self._file, chunk)
        if not found:
            self._sizes[chunk.start] = 0  # nobody unpacks it in vain again
        return found, unused

    def _singles(self, names: Mapping[int, str]) -> Iterator[tuple[int, tuple[str, bytes] | None]]:
        channels, times_ns, starts, ends = self._single
        for index in np.argsort(np.array(times_ns, np.uint64), kind="stable"):
            if channels[index] in names:
                record = mcap.Record(mcap.MESSAGE, starts[index], ends[index])
                try:
                    data = mcap.read_content(self._file, record)
                except ValueError:
                    self._gaps += ends[index] - starts[index]
                    continue
                yield times_ns[index], (names[channels[index]], data)


def topic_from_channel(channel: mcap.Channel, count: int) -> Topic:
    """Topic of a channel, with the number of its messages."""
    schema = channel.schema
    metadata = dict(schema.metadata)
    type_name, definition = schema.name, ""
    ros = schema.message_encoding == "cdr" and schema.name != ""
    if ros and schema.encoding in _ROS_SCHEMAS:
        definition = schema.data.decode(errors="replace")
    elif ros:
        # Other descriptions of types that ROS 2 has, such as IDL of the OMG.
        type_name = _ros_name(schema.name)
        ros = type_name in _known_types()
    if not ros:
        return Topic(channel.topic, str(schema), count=count, foreign=schema)
    try:
        qos = tuple(get_qos(channel.metadata))
    except DAMAGE:
        qos = ()
    type_hash = metadata.get("topic_type_hash", "")
    return Topic(channel.topic, type_name, definition, type_hash, qos, count)


def _ros_name(name: str) -> str:
    """Name of a type in the words of ROS 2: `sensor_msgs::msg::dds_::Image_` is of an Image."""
    parts = name.replace("::", "/").split("/")
    parts = [part.removesuffix("_") for part in parts if part != "dds_"]
    return "/".join(parts if len(parts) != 2 else [parts[0], "msg", parts[1]])


def _known_types() -> Mapping[str, object]:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY).fielddefs
