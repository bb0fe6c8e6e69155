"""How the files of a bag are named."""

import os
from pathlib import Path

# Suffixes of the files of a bag, and the names of the storages.
SUFFIXES = {".mcap": "mcap", ".db3": "sqlite3"}
# Behind them, of a file that was compressed as a whole.
PACKED = ".zstd"
METADATA = "metadata.yaml"


def storage_of(name: str) -> str | None:
    """Storage of a file by its name, `mcap` or `sqlite3`; None if it is no file of a bag."""
    return SUFFIXES.get(Path(name.lower().removesuffix(PACKED)).suffix)


def is_bag(path: str | os.PathLike[str]) -> bool:
    """Whether a path looks like a bag: its folder, whole or cut off, or a file of one."""
    path = Path(path)
    if path.is_dir():
        names = [file.name for file in path.iterdir()]
        return METADATA in names or any(map(storage_of, names))
    return path.is_file() and storage_of(path.name) is not None
