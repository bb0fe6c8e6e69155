"""Reading of files that somebody else may have written."""

import os
import stat
from pathlib import Path

from coded_aperture_ros.core.errors import InputError

# Of a picture; 67 million: more than cameras of robots have. In floats that is 256 MiB.
LARGEST_PIXELS = 2**26
# A picture of the most pixels in 32 bits.
LARGEST_FILE_BYTES = 4 * LARGEST_PIXELS + 2**16


def check_picture_size(rows: int, columns: int) -> None:
    """Raise `InputError` if a picture has more than `LARGEST_PIXELS`.

    Compressed files of few bytes may declare any size.

    Examples
    --------
    >>> check_picture_size(60_000, 60_000)
    Traceback (most recent call last):
    ...
    coded_aperture_ros.core.errors.InputError: 60000x60000 pixels, expected at most 67 million
    """
    if rows * columns > LARGEST_PIXELS:
        raise InputError(
            f"{columns}x{rows} pixels, expected at most {LARGEST_PIXELS // 10**6} million"
        )


def check_regular(
    path: str | os.PathLike[str], name: object, largest_bytes: int = LARGEST_FILE_BYTES
) -> int:
    """Size of a file, bytes, after a check that it may be read into memory.

    Parameters
    ----------
    path : str or path-like
    name : object
        What to call it in messages.
    largest_bytes : int

    Raises
    ------
    InputError
        If it is missing, no regular file (a device or a pipe may never end), or too large.

    Examples
    --------
    >>> check_regular("/dev/zero", "bank")
    Traceback (most recent call last):
    ...
    coded_aperture_ros.core.errors.InputError: cannot read bank: not a regular file
    """
    try:
        found = Path(path).stat()
    except OSError as error:
        raise InputError(f"cannot read {name}: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"cannot read {name}: {error}") from error
    if stat.S_ISDIR(found.st_mode):
        raise InputError(f"cannot read {name}: Is a directory")
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"cannot read {name}: not a regular file")
    if found.st_size > largest_bytes:
        raise InputError(
            f"cannot read {name}: {found.st_size} bytes, expected at most {largest_bytes}"
        )
    return found.st_size


def read_bytes(
    path: str | os.PathLike[str], name: object, largest_bytes: int = LARGEST_FILE_BYTES
) -> bytes:
    """Content of a file; see `check_regular` for parameters and errors."""
    check_regular(path, name, largest_bytes)
    try:
        with Path(path).open("rb") as file:
            data = file.read(largest_bytes + 1)
    except OSError as error:
        raise InputError(f"cannot read {name}: {error.strerror or error}") from error
    if len(data) > largest_bytes:
        raise InputError(f"cannot read {name}: it grows while it is read")
    return data
