"""Versioned `.npz` files of plain arrays; foreign, newer or truncated files are refused."""

import io
import os
import zipfile
import zlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from coded_aperture_ros.core.array_file import read_array
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.core.input_file import read_bytes

# Bytes of a file, and of all of its arrays. Banks with PSFs of every part have some 10 million.
LARGEST_ARCHIVE_BYTES = 2**28
# Largest table of contents; that of a bank has 3 kilobytes.
_LARGEST_CONTENTS_BYTES = 2**16
# End of a zip file: signature, where the size of its contents stands, and the length of all.
_END = b"PK\5\6"
_CONTENTS_SIZE = slice(12, 16)
_END_BYTES = 22
# In front of it where sizes have 64 bits, as none of ours has.
_LOCATOR = b"PK\6\7"
_LOCATOR_BYTES = 20
# Others need memory that the file chooses.
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# What is raised for a damaged file.
_DAMAGE_ERRORS = (
    OSError,
    ValueError,
    EOFError,
    KeyError,
    RuntimeError,  # of zipfile: the damage looks like encryption, or like another compression
    MemoryError,
    OverflowError,
    zipfile.BadZipFile,
    zlib.error,
)
# A longer schema is not shown in messages.
_LONGEST_SCHEMA = 80


def write_archive(
    path: str | os.PathLike[str], schema: str, version: int, arrays: Mapping[str, Any]
) -> None:
    """Write arrays to a compressed `.npz` with its schema and version, whole or not at all."""
    # In memory first: zipfile writes to stderr, beside raising, if a disk is full.
    content = io.BytesIO()
    np.savez_compressed(content, schema=schema, schema_version=version, **arrays)
    with atomic_output(path) as temporary:
        temporary.write_bytes(content.getvalue())


def read_archive(
    path: str | os.PathLike[str], schema: str, version: int, *, foreign: bool = False
) -> dict[str, NDArray[Any]]:
    """Arrays of a `.npz` by their names; nothing is unpickled.

    Parameters
    ----------
    path : path
    schema : str
        Kind of file that is expected.
    version : int
        Newest version that can be read.
    foreign : bool
        Whether a file that does not state a schema is read, too.

    Raises
    ------
    InputError
        If the file is missing, truncated, of another kind or of a newer version.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "numbers.npz"
    ...     write_archive(path, "example", 1, {"squares": [0, 1, 4]})
    ...     arrays = read_archive(path, "example", 1)
    >>> arrays["squares"]
    array([0, 1, 4])
    """
    path = Path(path)
    try:
        if not path.exists():
            raise InputError(f"{path}: no such file (a {schema} was expected)")
        content = read_bytes(path, path, LARGEST_ARCHIVE_BYTES)
        if content.startswith(npy.MAGIC_PREFIX):
            raise InputError(f"{path}: a single array, not a {schema} file (.npz)")
        arrays = _arrays(content)
        if any(np.iscomplexobj(array) for array in arrays.values()):
            raise InputError(f"{path}: holds complex numbers, not a {schema}")
    except InputError:
        raise
    except _DAMAGE_ERRORS as error:
        if isinstance(error, OSError) and error.errno:
            raise InputError(f"cannot read {path}: {error.strerror}") from error
        raise InputError(
            f"{path}: cannot be read as a {schema}: truncated, or not an .npz of plain arrays"
        ) from error
    stated = arrays.get("schema", np.array(""))
    found = (
        str(stated)
        if stated.ndim == 0 and len(str(stated)) < _LONGEST_SCHEMA
        else "some other .npz file"
    )
    if found != schema and not (foreign and not found):
        raise InputError(f"{path}: expected a {schema}, this is {found or 'some other .npz file'}")
    if _stated_version(arrays) > version:
        raise InputError(
            f"{path}: {schema} of version {_stated_version(arrays)}, but this release reads up to "
            f"version {version}: upgrade the package, or make the file again"
        )
    return arrays


def _arrays(content: bytes) -> dict[str, NDArray[Any]]:
    """Arrays of a zip file; one of `_DAMAGE_ERRORS` if it declares more than it may have."""
    end = content.rfind(_END, max(0, len(content) - _END_BYTES - 0xFFFF))
    if end < 0:
        raise zipfile.BadZipFile("no end")
    size = int.from_bytes(content[end : end + _END_BYTES][_CONTENTS_SIZE], "little")
    start = max(0, end - _LOCATOR_BYTES)
    if size > _LARGEST_CONTENTS_BYTES or content.startswith(_LOCATOR, start):
        raise zipfile.BadZipFile("too many members")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        if any(member.compress_type not in _COMPRESSIONS for member in members):
            raise zipfile.BadZipFile("a compression that NumPy does not use")
        if sum(member.file_size for member in members) > LARGEST_ARCHIVE_BYTES:
            raise zipfile.BadZipFile("more data than a file may have")
        return {
            member.filename.removesuffix(".npy"): read_array(archive.read(member)).copy()
            for member in members
        }


@cache
def read_shipped(module_file: str, name: str, schema: str, version: int) -> dict[str, NDArray[Any]]:
    """Arrays of an archive that lies beside a module of the package; read once."""
    return read_archive(Path(module_file).with_name(name), schema, version)


def _stated_version(arrays: Mapping[str, NDArray[Any]]) -> int:
    try:
        return int(arrays.get("schema_version", np.array(0)))
    except (TypeError, ValueError):
        return 0
