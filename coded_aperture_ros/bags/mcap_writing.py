"""MCAP files of new bags, which carry what other programs wrote beside messages of ROS 2."""

import io
import struct
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import (
    McapWriter,
    write_channel,
    write_record,
    write_schema,
    write_string,
    write_uint16,
    write_uint32,
    write_uint64,
)

from coded_aperture_ros.bags import mcap_records as mcap
from coded_aperture_ros.bags.contents import ForeignSchema, Supplement, Topic

_CHUNK_INDEX = 0x08
_ATTACHMENT_INDEX = 0x0A
_METADATA_INDEX = 0x0D
_DATA_END = 0x0F
# Channels and schemas of other programs are numbered from here downwards, ROS 2's from 1 upwards.
_LAST_NUMBER = 0xFFFF


class McapStorage(McapWriter):
    """MCAP file with channels of other programs, attachments and records of metadata.

    Those channels are not in `metadata.yaml`: rosbag2 refuses bags with more than one encoding.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._foreign_schemas: dict[tuple[str, str, bytes], int] = {}
        self._foreign_channels: list[io.BytesIO] = []
        self._supplements: list[tuple[int, io.BytesIO]] = []

    def add_foreign(self, topic: Topic, schema: ForeignSchema) -> Connection:
        """Add a channel as another program described it; the connection is for `write`."""
        number = _LAST_NUMBER - len(self._foreign_channels)
        record = io.BytesIO()
        write_uint16(record, number)
        write_uint16(record, self._schema_number(schema))
        write_string(record, topic.name)
        write_string(record, schema.message_encoding)
        pairs = io.BytesIO()
        for text in (text for pair in schema.metadata for text in pair):
            write_string(pairs, text)
        write_uint32(record, pairs.tell())
        record.write(pairs.getvalue())
        self._foreign_channels.append(record)
        write_record(self.chunk.bio, mcap.CHANNEL, record)
        self.channel_stats[number] = 0
        nothing: Any = None
        return Connection(number, topic.name, topic.type_name, nothing, "", 0, nothing, self)

    def add_supplement(self, supplement: Supplement) -> None:
        """Write an attachment or a record of metadata."""
        start = self.bio.tell()
        attached = supplement.kind == "attachment"
        kind = mcap.ATTACHMENT if attached else mcap.METADATA_RECORD
        write_record(self.bio, kind, _at_end(io.BytesIO(supplement.content)))
        index = io.BytesIO()
        write_uint64(index, start)
        write_uint64(index, self.bio.tell() - start)
        if attached:
            name, media_type, size = mcap.attachment_facts(supplement.content)
            index.write(supplement.content[:16])
            write_uint64(index, size)
            write_string(index, name)
            write_string(index, media_type)
        else:
            write_string(index, supplement.name)
        self._supplements.append((_ATTACHMENT_INDEX if attached else _METADATA_INDEX, index))

    def close(self, version: int, metadata: str) -> None:
        """Write what the file ends with, and close it."""
        if self.chunk.bio.tell():
            self.close_chunk()
        self.add_supplement(Supplement("metadata", "rosbag2", _metadata_content(metadata)))
        write_record(self.bio, _DATA_END, _packed("<I", 0))
        start = self.bio.tell()
        for schema in self.schemas:
            write_schema(self.bio, schema)
        for described, number in self._foreign_schemas.items():
            write_record(self.bio, mcap.SCHEMA, _schema_content(number, *described))
        for channel in self.channels:
            write_channel(self.bio, channel, self.schemas)
        for content in self._foreign_channels:
            write_record(self.bio, mcap.CHANNEL, content)
        for chunk in self.chunks:
            write_record(self.bio, _CHUNK_INDEX, chunk)
        for kind, index in self._supplements:
            write_record(self.bio, kind, index)
        write_record(self.bio, mcap.STATISTICS, self._statistics())
        write_record(self.bio, mcap.FOOTER, _packed("<QQI", start, 0, 0))
        self.bio.write(mcap.MAGIC)
        self.bio.close()

    def _schema_number(self, schema: ForeignSchema) -> int:
        """Number of a schema, which is written if it is new; 0 if there is none."""
        if not (schema.name or schema.encoding or schema.data):
            return 0
        described = schema.name, schema.encoding, schema.data
        if described not in self._foreign_schemas:
            number = _LAST_NUMBER - len(self._foreign_schemas)
            self._foreign_schemas[described] = number
            write_record(self.chunk.bio, mcap.SCHEMA, _schema_content(number, *described))
        return self._foreign_schemas[described]

    def _statistics(self) -> io.BytesIO:
        kinds = [kind for kind, _ in self._supplements]
        record = _packed(
            "<QHIIIIQQI",
            sum(self.channel_stats.values()),
            len(self.schemas) + len(self._foreign_schemas),
            len(self.channel_stats),
            kinds.count(_ATTACHMENT_INDEX),
            kinds.count(_METADATA_INDEX),
            len(self.chunks),
            self.message_start_time if any(self.channel_stats.values()) else 0,
            self.message_end_time,
            len(self.channel_stats) * 10,
        )
        for number, count in sorted(self.channel_stats.items()):
            record.write(struct.pack("<HQ", number, count))
        return record


class ForeignWriter(Writer):
    """Writer of rosbags whose MCAP files are those of this module."""

    STORAGE_PLUGINS = {**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: McapStorage}  # noqa: RUF012


def _schema_content(number: int, name: str, encoding: str, data: bytes) -> io.BytesIO:
    record = io.BytesIO()
    write_uint16(record, number)
    write_string(record, name)
    write_string(record, encoding)
    write_uint32(record, len(data))
    record.write(data)
    return record


def _metadata_content(metadata: str) -> bytes:
    """Content of the record of metadata that rosbag2 looks for."""
    pairs = io.BytesIO()
    write_string(pairs, "serialized_metadata")
    write_string(pairs, metadata)
    record = io.BytesIO()
    write_string(record, "rosbag2")
    write_uint32(record, pairs.tell())
    record.write(pairs.getvalue())
    return record.getvalue()


def _packed(layout: str, *values: int) -> io.BytesIO:
    """Content of a record, to be added to."""
    return _at_end(io.BytesIO(struct.pack(layout, *values)))


def _at_end(body: io.BytesIO) -> io.BytesIO:
    """The same content, at its end, from which rosbags takes its length."""
    body.seek(0, io.SEEK_END)
    return body
