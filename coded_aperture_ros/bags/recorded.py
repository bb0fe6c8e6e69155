"""What a recorded bag consists of, whichever way it is stored."""

import dataclasses
from typing import Any

# Of the files of a bag, and the name of what they hold.
SUFFIXES = {".mcap": "mcap", ".db3": "sqlite3"}
METADATA = "metadata.yaml"


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic of a bag; definition and hash of the type are empty if the bag does not have them."""

    name: str
    type_name: str  # as `sensor_msgs/msg/Image`
    definition: str = ""  # with those of the types in it
    type_hash: str = ""  # `RIHS01_...`
    qos: tuple[Any, ...] = ()  # profiles that were offered, as rosbags represents them
    count: int | None = None  # messages, if that is known


@dataclasses.dataclass(frozen=True)
class Recorded:
    """One message of a bag, as it was sent (CDR), and when it was recorded."""

    topic: str
    time_ns: int
    data: bytes
