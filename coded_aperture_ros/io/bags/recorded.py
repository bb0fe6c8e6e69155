"""What a recorded bag consists of, whichever way it is stored."""

import dataclasses
from typing import Any

# Of the files of a bag, and the name of what they hold.
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
