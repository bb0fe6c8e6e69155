"""Topics and messages of a bag, and how its files are named."""

import dataclasses
from typing import Any

# Suffixes of the files of a bag, and the names of the storages.
SUFFIXES = {".mcap": "mcap", ".db3": "sqlite3"}
METADATA = "metadata.yaml"


@dataclasses.dataclass(frozen=True)
class Topic:
    """Topic of a bag.

    Attributes
    ----------
    name : str
    type_name : str
        Such as ``sensor_msgs/msg/Image``.
    definition : str
        Of the type, with those of the types in it; empty if the bag has none.
    type_hash : str
        ``RIHS01_...``; empty if the bag has none.
    qos : tuple
        Profiles that were offered, as rosbags represents them.
    count : int or None
        Number of messages; None if unknown.
    """

    name: str
    type_name: str
    definition: str = ""
    type_hash: str = ""
    qos: tuple[Any, ...] = ()
    count: int | None = None


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
