"""Folders of results: filled beside their place, and put there at once."""

import ctypes
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from coded_aperture_ros.core.files import flush
from coded_aperture_ros.core.leftovers import REPLACED, remove_leftovers, temporary_name

# Of Linux: names are not relative to an open folder, and are exchanged.
_HERE = -100
_RENAME_EXCHANGE = 2


@contextmanager
def temporary_folder(path: Path) -> Iterator[Path]:
    """Temporary folder beside `path`; removed at the end, with parents created for it."""
    created = [parent for parent in path.absolute().parents if not parent.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        remove_leftovers(path.parent)
        temporary = path.parent / temporary_name(path.name)
        temporary.mkdir(mode=0o700)
        try:
            yield temporary
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    finally:
        if not path.exists():
            for parent in created:
                with suppress(OSError):
                    parent.rmdir()


def replace_folder(new: Path, path: Path) -> None:
    """Give a folder the name of another one, which gets the name of the first or is removed.

    At every moment a whole folder has the name. Only where a file system cannot exchange two names
    there is a moment without: if the process is killed in it, `remove_leftovers` gives the old
    folder its name again.
    """
    for file in (each for each in new.rglob("*") if each.is_file()):
        flush(file)
    flush(new)
    if not path.exists():
        new.rename(path)
    elif not _exchange(new, path):
        _replace_in_two_steps(new, path)
    flush(path.parent)


def _replace_in_two_steps(new: Path, path: Path) -> None:
    old = path.with_name(temporary_name(path.name, REPLACED))
    path.rename(old)
    try:
        new.rename(path)
    except OSError:
        old.rename(path)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two names at once; False if that cannot be done here."""
    rename = getattr(ctypes.CDLL(None), "renameat2", None)
    if rename is None:
        return False
    names = (os.fsencode(each.absolute()) for each in (one, other))
    first, second = names
    return bool(rename(_HERE, first, _HERE, second, _RENAME_EXCHANGE) == 0)
