"""Writing of bags, which appear whole or not at all."""

import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from coded_aperture_ros.bags.contents import Supplement, Topic
from coded_aperture_ros.bags.names import METADATA
from coded_aperture_ros.bags.reading import check_rosbags
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.folders import replace_folder, temporary_folder
from coded_aperture_ros.core.leftovers import remove_leftovers

# Of bags as ROS 2 Jazzy writes them.
_VERSION = 9
_NO_HASH = "RIHS01_" + 64 * "0"


class BagWriter:
    """Writes messages into a new bag; made by `bag_output`.

    What else is put into its `folder`, before the bag has its name, comes along.
    """

    def __init__(self, folder: Path, storage: str) -> None:
        from rosbags.rosbag2 import StoragePlugin

        from coded_aperture_ros.bags.mcap_writing import ForeignWriter, McapStorage

        self.folder = folder
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        self._writer = ForeignWriter(folder, version=_VERSION, storage_plugin=plugin)
        self._writer.open()
        opened = self._writer.storage
        # Only an MCAP file takes what is not of ROS 2.
        self._mcap = opened if isinstance(opened, McapStorage) else None
        self._connections: dict[str, Any] = {}
        self._closed = False

    def takes(self, topic: Topic) -> bool:
        """Whether a topic can be added: one of another program cannot, in SQLite."""
        return topic.foreign is None or self._mcap is not None

    def add_topic(self, topic: Topic) -> None:
        """Add a topic; one without definition or hash of its type gets what is known of them."""
        if topic.foreign is not None and self._mcap is not None:
            self._connections[topic.name] = self._mcap.add_foreign(topic, topic.foreign)
            return
        definition = topic.definition
        type_hash = topic.type_hash
        if not (definition and type_hash):
            definition, type_hash = _known_type(topic)
        self._connections[topic.name] = self._writer.add_connection(
            topic.name,
            topic.type_name,
            msgdef=definition,
            rihs01=type_hash,
            offered_qos_profiles=topic.qos,
        )

    def __contains__(self, topic: str) -> bool:
        """Whether a topic was added."""
        return topic in self._connections

    def write(self, topic: str, time_ns: int, data: bytes | memoryview) -> None:
        """Write a message to a topic that was added."""
        connection = self._connections[topic]
        if self._mcap is not None and connection.owner is self._mcap:
            self._mcap.write(connection, time_ns, data)
        else:
            self._writer.write(connection, time_ns, data)

    def add_supplement(self, supplement: Supplement) -> None:
        """Write an attachment or a record of metadata into an MCAP file."""
        if self._mcap is not None:
            self._mcap.add_supplement(supplement)

    def close(self) -> None:
        """Write what a bag ends with; once is enough."""
        if not self._closed:
            self._writer.close()
            self._closed = True

    def abort(self) -> None:
        """Close the files, complete or not."""
        self._writer.abort()


def _known_type(topic: Topic) -> tuple[str, str]:
    """Definition and hash of a topic's type, as far as they are known."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    from rosbags.typesys.base import TypesysError

    store = get_typestore(Stores.ROS2_JAZZY)
    unknown = topic.definition, topic.type_hash or _NO_HASH
    try:
        if topic.definition and not topic.definition.startswith("==="):
            types = get_types_from_msg(topic.definition, topic.type_name)
            new = {name: kind for name, kind in types.items() if name not in store.fielddefs}
            store.register(new)
        if topic.type_name not in store.fielddefs:
            return unknown
        definition, _ = store.generate_msgdef(topic.type_name, ros_version=2)
    except TypesysError:  # nobody can read the definition: it is copied
        return unknown
    return topic.definition or definition, topic.type_hash or store.hash_rihs01(topic.type_name)


def check_bag_output(path: Path, inputs: Iterable[Path], overwrite: bool) -> None:
    """Raise `InputError` if a bag cannot be written, before anything is computed."""
    for given in inputs:
        if path.exists() and path.resolve() in (given.resolve(), *given.resolve().parents):
            raise InputError(f"{path}: the input {given} would be overwritten: use another name")
    for folder in path.resolve().parents:
        if (folder / METADATA).is_file():
            raise InputError(f"cannot write {path}: {folder} is a bag: use a folder outside it")
        if folder.is_file():
            raise InputError(f"cannot write {path}: {folder} is not a folder")
    remove_leftovers(path.parent)  # a bag that was about to be replaced has its name again
    if path.exists() or path.is_symlink():
        if not overwrite:
            raise InputError(f"{path} exists already: use another name, or --overwrite")
        if not (path / METADATA).is_file():
            raise InputError(f"{path} exists already and is no bag: it will not be overwritten")
    with describe_write_errors(path), temporary_folder(path):
        pass


@contextmanager
def bag_output(path: Path, storage: str) -> Iterator[BagWriter]:
    """Yield a writer of a bag that gets its name, or replaces another bag, at the end.

    Parameters
    ----------
    path : Path
        Folder of the bag; missing parent folders are created.
    storage : str
        `mcap` or `sqlite3`.

    Raises
    ------
    InputError
        If it cannot be written; nothing is left behind then.
    """
    check_rosbags()
    with describe_write_errors(path), temporary_folder(path) as temporary:
        # Files of a bag are named like its folder.
        writer = BagWriter(temporary / path.name, storage)
        try:
            yield writer
            writer.close()
        except BaseException:
            with suppress(OSError, sqlite3.Error):
                writer.abort()
            raise
        # An older bag comes into the temporary folder, and goes with it.
        replace_folder(writer.folder, path)


@contextmanager
def describe_write_errors(path: Path) -> Iterator[None]:
    """Raise `InputError` in place of errors of files and of SQLite."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or os.strerror(error.errno or 0)
        raise InputError(f"cannot write {path}: {reason}") from error
    except sqlite3.Error as error:
        raise InputError(f"cannot write {path}: {error}") from error
