"""Names of temporary files and folders, by which a later process finds those of killed ones."""

import hashlib
import os
import re
import secrets
import shutil
import socket
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

# Suffix of a whole folder whose place another one takes.
REPLACED = ".replaced"
# Stem, host, space of process numbers, process, and a number by chance; then the suffix.
_NAME = re.compile(r"\.(.*)-([0-9a-f]{6})-n([0-9]+)-p([0-9]+)-[0-9a-f]{8}(\.[^.]*)?")
# Whether a process of another container lives cannot be seen. Nothing is written for so long
# without a change to its file or folder.
_UNTOUCHED_S = 24 * 3600
_looked_through: set[tuple[int, int, int]] = set()


def temporary_name(stem: str, suffix: str = "") -> str:
    """Hidden name that says which process of which machine has made it.

    Examples
    --------
    >>> name = temporary_name("depth", ".npy")
    >>> name.startswith(".depth-"), name.endswith(".npy"), _is_left(Path(name))
    (True, True, False)
    """
    return f".{stem}-{_host()}-n{_numbers()}-p{os.getpid()}-{secrets.token_hex(4)}{suffix}"


def remove_leftovers(folder: Path) -> None:
    """Remove what processes of this machine left in a folder when they were killed.

    A folder that was about to be replaced gets its name again if nothing else has it. Each process
    looks once through each folder.
    """
    with suppress(OSError):
        found = folder.stat()
        key = os.getpid(), found.st_dev, found.st_ino
        if key in _looked_through:
            return
        _looked_through.add(key)
        for path in list(folder.iterdir()):
            if _is_left(path):
                _clear(path)


def _clear(left: Path) -> None:
    """Remove a file or folder, or give a replaced folder its name again."""
    match = _NAME.fullmatch(left.name)
    assert match is not None
    named = left.with_name(match[1])
    with suppress(OSError):
        if left.is_symlink() or not left.is_dir():
            left.unlink()
        elif match[5] == REPLACED and not os.path.lexists(named):
            left.rename(named)
        else:
            shutil.rmtree(left, ignore_errors=True)


def _is_left(path: Path) -> bool:
    """Whether a path is that of a temporary file whose process has ended."""
    match = _NAME.fullmatch(path.name)
    if match is None or match[2] != _host():
        return False
    with suppress(PermissionError, OverflowError):  # of another user, or no number of a process
        if int(match[3]) != _numbers():
            changed = max(entry.lstat().st_mtime for entry in (path, *path.rglob("*")))
            return time.time() - changed > _UNTOUCHED_S
        try:
            os.kill(int(match[4]), 0)
        except ProcessLookupError:
            return True
    return False


@cache
def _host() -> str:
    # Processes of another machine have the same numbers.
    return hashlib.sha256(socket.gethostname().encode()).hexdigest()[:6]


@cache
def _numbers() -> int:
    """Space of process numbers: each container has its own, while the host's name may be shared."""
    with suppress(OSError):
        return Path("/proc/self/ns/pid").stat().st_ino
    return 0
