"""Topics and messages of a bag."""

import dataclasses
import struct
from typing import Any

# Of a file. Robots have hundreds.
MOST_TOPICS = 10_000
# Where CDR has seconds and nanoseconds of a header, bytes.
_STAMP_START, _STAMP_END = 4, 12


@dataclasses.dataclass(frozen=True)
class ForeignSchema:
    """Encoding of the messages of a program that is not of ROS 2, as an MCAP file describes it.

    Attributes
    ----------
    message_encoding : str
        Such as ``json``, ``protobuf``, ``ros1``.
    name : str
        Of the type; empty if the channel has no schema.
    encoding : str
        Of the schema, such as ``jsonschema``; empty without a schema.
    data : bytes
        The schema.
    metadata : tuple of (str, str)
        Of the channel.
    """

    message_encoding: str
    name: str = ""
    encoding: str = ""
    data: bytes = b""
    metadata: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        encoding = self.message_encoding or "no encoding"
        return f"{self.name or 'no schema'} ({encoding})"


@dataclasses.dataclass(frozen=True)
class Topic:
    """Topic of a bag.

    Attributes
    ----------
    name : str
    type_name : str
        Such as ``sensor_msgs/msg/Image``; of another program's, its `foreign` in words.
    definition : str
        Of the type, with those of the types in it; empty if the bag has none.
    type_hash : str
        ``RIHS01_...``; empty if the bag has none.
    qos : tuple
        Profiles that were offered, as rosbags represents them.
    count : int or None
        Number of messages; None if unknown.
    foreign : ForeignSchema or None
        None if the messages are of ROS 2.
    """

    name: str
    type_name: str
    definition: str = ""
    type_hash: str = ""
    qos: tuple[Any, ...] = ()
    count: int | None = None
    foreign: ForeignSchema | None = None

    def __str__(self) -> str:
        return f"{self.name} of {self.type_name}"


@dataclasses.dataclass(frozen=True)
class BagMessage:
    """Message of a bag.

    Attributes
    ----------
    topic : str
    time_ns : int
        Time of the recording.
    data : bytes
        The message as it was sent (CDR).
    """

    topic: str
    time_ns: int
    data: bytes

    @property
    def stamp_ns(self) -> int:
        """Stamp of a message that begins with a header, ns; 0 if it is too short."""
        if len(self.data) < _STAMP_END:
            return 0
        layout = "<iI" if self.data[1] & 1 else ">iI"
        seconds, nanoseconds = struct.unpack_from(layout, self.data, _STAMP_START)
        return int(seconds) * 10**9 + int(nanoseconds)


@dataclasses.dataclass(frozen=True)
class Supplement:
    """Attachment or metadata record of an MCAP file, which no message is.

    Attributes
    ----------
    kind : str
        ``attachment`` or ``metadata``.
    name : str
    content : bytes
        Of the record, as it stands in the file.
    """

    kind: str
    name: str
    content: bytes

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"
