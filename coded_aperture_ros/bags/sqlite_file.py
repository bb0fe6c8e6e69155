"""SQLite files of bags, complete or damaged."""

import sqlite3
from array import array
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from rosbags.rosbag2.metadata import parse_qos

from coded_aperture_ros.bags.contents import (
    MOST_TOPICS,
    BagMessage,
    ForeignSchema,
    Supplement,
    Topic,
)
from coded_aperture_ros.bags.damage import DAMAGE
from coded_aperture_ros.bags.sqlite_guard import GuardedDatabase

# What is left out where rows share bytes of the file.
_TOO_MUCH = "there is more in them than in the file"


class SqliteFile:
    """`.db3` file, as a part of a bag; raises `sqlite3.Error` if nothing can be read.

    Attributes
    ----------
    topics : list of Topic
    damage : str
        What is wrong with the file, as far as it was read.
    """

    storage = "sqlite3"

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage = ""
        self._size = path.stat().st_size
        self._database = GuardedDatabase(path)
        try:
            self._database.check_tables()
            counts = self._counts()
            self._topics = self._read_topics(counts)
        except sqlite3.Error:
            self._database.close()
            raise
        self.topics = list(self._topics.values())

    def messages(self, wanted: Mapping[str, str]) -> Iterator[BagMessage]:
        """Yield messages, of topics with their types, in the order of their recording.

        Those that cannot be read are left out; of a damaged file they come in the order in which
        they were written.
        """
        names = {
            number: topic.name
            for number, topic in self._topics.items()
            if wanted.get(topic.name) == topic.type_name
        }
        query = "SELECT timestamp, data FROM messages WHERE id = ?"
        lost = 0
        reason = ""
        left = self._size
        numbers, topics = self._order()
        for number, topic in zip(numbers, topics, strict=True):
            if topic not in names:
                continue
            try:
                if left < 0:
                    raise sqlite3.DataError(_TOO_MUCH)
                time_ns, data = self._database.execute(query, (number,)).fetchone()
                if not (isinstance(time_ns, int) and isinstance(data, bytes)):
                    raise sqlite3.DataError("a time or its data are of another type")
                left -= len(data)
            # Or there is none of this number.
            except (sqlite3.Error, TypeError, OverflowError, MemoryError) as error:
                lost += 1
                reason = str(error)
                continue
            yield BagMessage(names[topic], time_ns, data)
        if lost:
            self.damage = f"{self.path.name} is damaged, {lost} messages cannot be read ({reason})"

    def supplements(self) -> Iterator[Supplement]:
        """Yield nothing: such a file holds messages alone."""
        return iter(())

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _counts(self) -> dict[int, int] | None:
        """Number of messages of each topic; None if the file is damaged."""
        try:
            return dict(
                self._database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id")
            )
        except sqlite3.Error as error:
            self.damage = f"{self.path.name} is damaged ({error})"
            return None

    def _order(self) -> tuple["array[int]", "array[int]"]:
        """Numbers of the messages and of their topics, in the order of the times if they are known.

        That goes by an index, which may be lost; then first those in front of the damage, and then
        those behind it.
        """
        columns = (
            "SELECT id, ifnull(CAST(topic_id AS INTEGER), -1) FROM messages "
            "WHERE typeof(id) = 'integer'"
        )
        numbers: array[int] = array("q")
        topics: array[int] = array("q")
        if not self.damage:
            with suppress(sqlite3.Error):
                for number, topic in self._database.execute(f"{columns} ORDER BY timestamp, id"):
                    numbers.append(number)
                    topics.append(topic)
                return numbers, topics
            del numbers[:], topics[:]
        with suppress(sqlite3.Error):
            for number, topic in self._database.execute(f"{columns} ORDER BY id"):
                numbers.append(number)
                topics.append(topic)
            return numbers, topics
        last = numbers[-1] if numbers else None
        behind: list[tuple[int, int]] = []
        with suppress(sqlite3.Error):
            for number, topic in self._database.execute(f"{columns} ORDER BY id DESC"):
                if last is not None and number <= last:
                    break
                behind.append((number, topic))
        for number, topic in reversed(behind):
            numbers.append(number)
            topics.append(topic)
        return numbers, topics

    def _read_topics(self, counts: Mapping[int, int] | None) -> dict[int, Topic]:
        columns = {row[1] for row in self._database.execute("PRAGMA table_info(topics)")}
        optional = ("offered_qos_profiles", "type_description_hash", "serialization_format")
        found = [name if name in columns else "''" for name in optional]
        definitions = self._definitions()
        query = f"SELECT id, name, type, {', '.join(found)} FROM topics ORDER BY id"
        topics: dict[int, Topic] = {}
        left = self._size
        for number, name, *others in self._database.execute(query):
            if len(topics) == MOST_TOPICS:
                raise sqlite3.DataError(f"it has more than {MOST_TOPICS} topics")
            type_name, qos, type_hash, encoding = map(_text, others)
            left -= sum(len(str(each)) for each in (name, type_name, qos, type_hash, encoding))
            if left < 0 or not (isinstance(number, int) and isinstance(name, str)):
                raise sqlite3.DataError(_TOO_MUCH if left < 0 else "a topic has no name")
            count = None if counts is None else counts.get(number, 0)
            if encoding not in ("cdr", ""):
                foreign = ForeignSchema(encoding, type_name)
                topics[number] = Topic(name, str(foreign), count=count, foreign=foreign)
                continue
            definition = definitions.get(type_name, "")
            topics[number] = Topic(name, type_name, definition, type_hash, _qos(qos), count)
        return topics

    def _definitions(self) -> dict[str, str]:
        query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
        try:
            found = dict(self._database.execute(query))
            return {name: _text(definition) for name, definition in found.items()}
        except sqlite3.Error:  # older bags have none
            return {}


def _text(value: object) -> str:
    """Value of a column of text, which may be of any type; empty if it is none."""
    return value if isinstance(value, str) else ""


def _qos(text: str) -> tuple[object, ...]:
    """Profiles of a topic; none if they cannot be read."""
    try:
        return tuple(parse_qos(text)) if text else ()
    except DAMAGE:
        return ()
