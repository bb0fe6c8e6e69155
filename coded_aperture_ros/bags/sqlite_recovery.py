"""SQLite files whose recorder died: recovered by SQLite itself, on a copy.

Beside such a file are a rollback journal (`-journal`) with the pages of a transaction that did not
end, or a write-ahead log (`-wal`) with pages that have not come into the file. SQLite puts that
right when it opens the file, and writes into it; the recording must stay as it is.
"""

import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

from coded_aperture_ros.bags.damage import one_line
from coded_aperture_ros.bags.sqlite_guard import GuardedDatabase

_SUFFIXES = ("-journal", "-wal")


def leftovers(path: Path) -> list[Path]:
    """Files beside an SQLite file that hold a part of its content."""
    return [file for suffix in _SUFFIXES if _is_hot(file := path.with_name(path.name + suffix))]


def _is_hot(file: Path) -> bool:
    """Whether a file is there, and SQLite has not made it empty, or begin with zeros."""
    try:
        with file.open("rb") as content:
            return content.read(1) not in (b"", b"\0")
    except FileNotFoundError:
        return False


def recovered(path: Path, left: list[Path], new_folder: Callable[[], Path]) -> tuple[Path, str]:
    """Copy of an SQLite file as SQLite recovers it, and what was done, or not, in words.

    Parameters
    ----------
    path : Path
    left : list of Path
        See `leftovers`.
    new_folder : callable
        Makes a folder for the copy, which has the name of the file.

    Returns
    -------
    path : Path
        Of the copy, or else of the file itself.
    damage : str
    """
    names = " and ".join(file.name for file in left)
    try:
        folder = new_folder()
        copy = folder / path.name
        for file in (path, *left):
            shutil.copyfile(file, folder / file.name)
        database = GuardedDatabase(copy, writable=True)
        try:
            # What is in a write-ahead log goes into the file, too.
            database.execute("PRAGMA journal_mode = DELETE").fetchall()
            database.execute("SELECT count(*) FROM sqlite_master").fetchall()
        finally:
            database.close()
    except (OSError, sqlite3.Error) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or one_line(error)
        return path, f"{names} left out, because {path.name} could not be recovered ({reason})"
    return copy, f"{path.name} was not closed, recovered by means of {names}"
