"""Weights' files of the package: written, read, and run by the package."""

import hashlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from shards import Arrays

from coded_aperture_ros.core.archive import read_archive, write_archive


def write_weights(path: Path, module: ModuleType, arrays: Mapping[str, Any]) -> None:
    """Write a weights' file; print its size and checksum.

    The module of the package that reads the file says its `SCHEMA` and `SCHEMA_VERSION`.
    """
    write_archive(path, module.SCHEMA, module.SCHEMA_VERSION, arrays)
    packed = path.read_bytes()
    print(f"{path}: {len(packed)} bytes, sha256 {hashlib.sha256(packed).hexdigest()}", flush=True)


def read_weights(path: Path, module: ModuleType) -> Arrays:
    """Arrays of a weights' file, see `write_weights`, without what is stated of the file."""
    arrays = read_archive(path, module.SCHEMA, module.SCHEMA_VERSION)
    return {name: array for name, array in arrays.items() if not name.startswith("schema")}


@contextmanager
def package_weights(path: Path, module: ModuleType) -> Iterator[None]:
    """Let a module of the package run the weights of a file in place of those that ship."""
    arrays = read_weights(path, module)
    usual = module.read_shipped
    module.read_shipped = lambda *_: arrays
    try:
        yield
    finally:
        module.read_shipped = usual
