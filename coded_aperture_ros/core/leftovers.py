"""Names of temporary files and folders, by which a later process finds those of killed ones."""

import hashlib
import os
import re
import secrets
import shutil
import socket
from contextlib import suppress
from functools import cache
from pathlib import Path

# Host, process, and a number by chance; then the suffix.
_NAME = re.compile(r"\..*-([0-9a-f]{6})-p([0-9]+)-[0-9a-f]{8}(\.[^.]*)?")
_looked_through: set[tuple[int, int, int]] = set()


def temporary_name(stem: str, suffix: str = "") -> str:
    """Hidden name that says which process of which machine has made it.

    Examples
    --------
    >>> name = temporary_name("depth", ".npy")
    >>> name.startswith(".depth-"), name.endswith(".npy"), _is_left(name)
    (True, True, False)
    """
    return f".{stem}-{_host()}-p{os.getpid()}-{secrets.token_hex(4)}{suffix}"


def remove_leftovers(folder: Path) -> None:
    """Remove what processes of this machine left in a folder when they were killed.

    Each process looks once through each folder.
    """
    with suppress(OSError):
        found = folder.stat()
        key = os.getpid(), found.st_dev, found.st_ino
        if key in _looked_through:
            return
        _looked_through.add(key)
        for entry in list(os.scandir(folder)):
            if not _is_left(entry.name):
                continue
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            else:
                with suppress(OSError):
                    Path(entry.path).unlink()


def _is_left(name: str) -> bool:
    """Whether a name is that of a temporary file whose process has ended."""
    match = _NAME.fullmatch(name)
    if match is None or match[1] != _host():
        return False
    try:
        os.kill(int(match[2]), 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):  # of another user, or no number of a process
        return False
    return False


@cache
def _host() -> str:
    # Processes of another machine, or of another container, have the same numbers.
    return hashlib.sha256(socket.gethostname().encode()).hexdigest()[:6]
