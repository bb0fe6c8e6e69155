"""Files of a bag, and what its `metadata.yaml` says of them."""

import dataclasses
import re
from pathlib import Path, PurePath
from typing import Any

from coded_aperture_ros.bags.names import METADATA, PACKED
from coded_aperture_ros.core.yaml_file import read_yaml


@dataclasses.dataclass(frozen=True)
class Layout:
    """What `metadata.yaml` says of the files of a bag.

    Attributes
    ----------
    files : tuple of str
        Names, in their order.
    packed_messages : bool
        Whether each message was compressed by itself.
    type_hashes : dict of str to str
        By the names of the topics.
    """

    files: tuple[str, ...] = ()
    packed_messages: bool = False
    type_hashes: dict[str, str] = dataclasses.field(default_factory=dict)


def read_layout(folder: Path) -> Layout:
    """Layout of a bag.

    Raises
    ------
    PermissionError
    ValueError
        If `metadata.yaml` is damaged.
    """
    try:
        found: Any = read_yaml(folder / METADATA, METADATA)["rosbag2_bagfile_information"]
        mode = (found.get("compression_mode") or "").lower()
        compression = found.get("compression_format") or ""
        topics = [each["topic_metadata"] for each in found.get("topics_with_message_count") or ()]
        layout = Layout(
            tuple(PurePath(name).name for name in found["relative_file_paths"]),
            mode == "message",
            {each["name"]: each.get("type_description_hash") or "" for each in topics},
        )
    except (OSError, KeyError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error.__cause__, PermissionError):
            raise error.__cause__ from error
        raise ValueError(f"{METADATA} cannot be read") from error
    if mode not in ("", "none") and compression != "zstd":
        raise ValueError(f"its compression {compression} is not supported")
    return layout


def by_number(name: str) -> list[tuple[bool, int, str]]:
    """Sort key for names with numbers: file 10 comes after file 9."""
    parts = re.split(r"(\d+)", name)
    return [(part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]


def same_recording(name: str, others: tuple[str, ...]) -> bool:
    """Whether a file is named like those of a recording: they differ in their number alone."""
    return _without_number(name) in map(_without_number, others)


def _without_number(name: str) -> str:
    stem, _, suffix = name.removesuffix(PACKED).rpartition(".")
    return f"{re.sub(r'_[0-9]+$', '', stem)}.{suffix}"
