"""SQLite files that are damaged: messages before the damage."""

import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import quote

from coded_aperture_ros.bags.contents import BagMessage, Topic


class CutSqlite:
    """Damaged `.db3` file, as a `Part` of a bag; raises `sqlite3.Error` if nothing can be read."""

    storage = "sqlite3"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._database = sqlite3.connect(
            f"file:{quote(str(path))}?immutable=1", uri=True, check_same_thread=False
        )
        try:
            # Without it SQLite refuses a file that is shorter than it says of itself.
            self._database.execute("PRAGMA writable_schema = ON")
            self._names = dict(self._database.execute("SELECT id, name FROM topics"))
            self.topics = self._read_topics()
        except sqlite3.Error:
            self._database.close()
            raise
        self.damage = f"{path.name} is damaged"

    def messages(self, topics: Sequence[str]) -> Iterator[BagMessage]:
        """Yield messages in the order in which they were written, up to the damage."""
        # Not in the order of their times: that goes by an index, which may be lost.
        query = "SELECT topic_id, timestamp, data FROM messages ORDER BY id"
        count = 0
        try:
            for topic, time_ns, data in self._database.execute(query):
                name = self._names.get(topic, "")
                if name in topics:
                    yield BagMessage(name, time_ns, data)
                count += 1
        except sqlite3.Error as error:
            self.damage = f"{self.path.name} is damaged behind {count} messages ({error})"

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _read_topics(self) -> list[Topic]:
        columns = {row[1] for row in self._database.execute("PRAGMA table_info(topics)")}
        type_hash = "type_description_hash" if "type_description_hash" in columns else "''"
        query = f"SELECT name, type, {type_hash} FROM topics ORDER BY id"
        definitions = self._definitions()
        return [
            Topic(name, type_name, definitions.get(type_name, ""), digest)
            for name, type_name, digest in self._database.execute(query)
        ]

    def _definitions(self) -> dict[str, str]:
        query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
        try:
            return dict(self._database.execute(query))
        except sqlite3.Error:  # older bags have none
            return {}
