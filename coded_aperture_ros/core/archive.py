"""Versioned `.npz` files of plain arrays; foreign, newer or truncated files are refused."""

import io
import os
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output

# What NumPy raises for a damaged file.
_DAMAGE_ERRORS = (
    OSError,
    ValueError,
    EOFError,
    KeyError,
    RuntimeError,  # of zipfile: the damage looks like encryption, or like another compression
    MemoryError,  # the damaged size of an array is enormous
    SyntaxError,  # NumPy reads the headers of old files with Python's own tokenizer
    tokenize.TokenError,
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
        with path.open("rb") as file:
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise InputError(f"{path}: a single array, not a {schema} file (.npz)")
            arrays = {name: archive[name] for name in archive.files}
            if any(np.iscomplexobj(array) for array in arrays.values()):
                raise InputError(f"{path}: holds complex numbers, not a {schema}")
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such file (a {schema} was expected)") from None
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


@cache
def read_shipped(module_file: str, name: str, schema: str, version: int) -> dict[str, NDArray[Any]]:
    """Arrays of an archive that lies beside a module of the package; read once."""
    return read_archive(Path(module_file).with_name(name), schema, version)


def _stated_version(arrays: Mapping[str, NDArray[Any]]) -> int:
    try:
        return int(arrays.get("schema_version", np.array(0)))
    except (TypeError, ValueError):
        return 0
