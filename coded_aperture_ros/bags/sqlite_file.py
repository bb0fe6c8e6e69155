"""SQLite files of bags, complete or damaged."""

import sqlite3
from array import array
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

from rosbags.rosbag2.metadata import parse_qos

from coded_aperture_ros.bags.contents import BagMessage, ForeignSchema, Supplement, Topic
from coded_aperture_ros.bags.damage import DAMAGE

_IMMUTABLE = "file:{}?immutable=1"


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
        # Immutable: SQLite leaves no files beside it, and needs none.
        self._database = sqlite3.connect(
            _IMMUTABLE.format(quote(str(path))), uri=True, check_same_thread=False
        )
        try:
            # Without it SQLite refuses a file that is shorter than it says of itself.
            self._database.execute("PRAGMA writable_schema = ON")
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
        numbers, topics = self._order()
        for number, topic in zip(numbers, topics, strict=True):
            if topic not in names:
                continue
            try:
                time_ns, data = self._database.execute(query, (number,)).fetchone()
            except (sqlite3.Error, TypeError) as error:  # or there is none of this number
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
        columns = "SELECT id, topic_id FROM messages"
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
        topics = {}
        for number, name, type_name, qos, type_hash, encoding in self._database.execute(query):
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
            return dict(self._database.execute(query))
        except sqlite3.Error:  # older bags have none
            return {}


def _qos(text: str) -> tuple[object, ...]:
    """Profiles of a topic; none if they cannot be read."""
    try:
        return tuple(parse_qos(text)) if text else ()
    except DAMAGE:
        return ()
