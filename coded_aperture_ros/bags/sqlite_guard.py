"""SQLite files of strangers: tables alone, and no more work or memory than their size allows.

A file may declare views, triggers, virtual tables and computed columns, which run as code when it
is read, and its pages may lead in circles, which stand for any number of rows.
"""

import sqlite3
from pathlib import Path
from urllib.parse import quote

from coded_aperture_ros.bags.compression import LARGEST_UNPACKED_BYTES

# Immutable: SQLite leaves no files beside it, and needs none.
_IMMUTABLE = "file:{}?mode=ro&immutable=1"
# Steps of SQLite's machine from one check to the next, and those of one query: so many, and so
# many for each byte of the file. Counting and sorting messages takes three a byte at most.
_STEPS = 100_000
_STEPS_FREE = 10_000_000
_STEPS_PER_BYTE = 16
_LONGEST_SQL_BYTES = 2**16
_MOST_COLUMNS = 100
_TABLES = ("topics", "messages", "message_definitions", "metadata", "schema")
# In the list of columns: those of a virtual table, and computed ones.
_HIDDEN = 6
# How a table is declared that a module of SQLite makes up.
_VIRTUAL = "CREATE VIRTUAL%"


class GuardedDatabase:
    """Read-only connection that ends a query that goes on for too long.

    Parameters
    ----------
    path : Path
    writable : bool
        Of a copy that SQLite shall recover.

    Raises
    ------
    sqlite3.Error
        If it cannot be opened, or a table of a bag in it is none.
    """

    def __init__(self, path: Path, *, writable: bool = False) -> None:
        self._most_steps = _STEPS_FREE + _STEPS_PER_BYTE * path.stat().st_size
        self._steps = 0
        name = str(path) if writable else _IMMUTABLE.format(quote(str(path)))
        self._database = sqlite3.connect(name, uri=not writable, check_same_thread=False)
        try:
            self._limit(path.stat().st_size)
            self._database.set_progress_handler(self._is_too_long, _STEPS)
            self._database.execute("PRAGMA trusted_schema = OFF")
            self._database.execute("PRAGMA cell_size_check = ON")
            if not writable:
                # Without it SQLite refuses a file that is shorter than it says of itself.
                self._database.execute("PRAGMA writable_schema = ON")
                self._database.execute("PRAGMA query_only = ON")
        except sqlite3.Error:
            self._database.close()
            raise

    def execute(self, query: str, values: tuple[int, ...] = ()) -> sqlite3.Cursor:
        """Rows of a query."""
        self._steps = 0
        return self._database.execute(query, values)

    def check_tables(self) -> None:
        """Raise `sqlite3.DatabaseError` if something of the name of a table computes its rows."""
        marks = ", ".join("?" * len(_TABLES))
        query = (
            f"SELECT name FROM sqlite_master WHERE lower(name) IN ({marks}) "
            f"AND (type <> 'table' OR sql LIKE '{_VIRTUAL}')"
        )
        self._steps = 0
        found = self._database.execute(query, _TABLES).fetchone()
        if found:
            raise sqlite3.DatabaseError(f"{found[0]} is no table: nothing of it is run")
        for name in _TABLES[:3]:
            columns = self.execute(f"PRAGMA table_xinfo({name})").fetchall()
            if any(column[_HIDDEN] for column in columns):
                raise sqlite3.DatabaseError(f"{name} has computed columns: nothing of it is run")

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _limit(self, size: int) -> None:
        if not hasattr(self._database, "setlimit"):  # Python 3.10
            return
        largest = {
            # A row is not longer than the file; its pages may say that it is.
            sqlite3.SQLITE_LIMIT_LENGTH: min(max(size, 2**16), LARGEST_UNPACKED_BYTES),
            sqlite3.SQLITE_LIMIT_SQL_LENGTH: _LONGEST_SQL_BYTES,
            sqlite3.SQLITE_LIMIT_COLUMN: _MOST_COLUMNS,
            sqlite3.SQLITE_LIMIT_ATTACHED: 0,
            sqlite3.SQLITE_LIMIT_TRIGGER_DEPTH: 0,
            sqlite3.SQLITE_LIMIT_WORKER_THREADS: 0,
        }
        for limit, value in largest.items():
            self._database.setlimit(limit, value)

    def _is_too_long(self) -> bool:
        self._steps += _STEPS
        return self._steps > self._most_steps
