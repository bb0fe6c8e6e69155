"""Opening the files of a bag, each as far as it can be read."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

from coded_aperture_ros.bags.compression import most_unpacked
from coded_aperture_ros.bags.damage import DAMAGE, one_line, zstd
from coded_aperture_ros.bags.layout import Layout, by_number, read_layout, same_recording
from coded_aperture_ros.bags.mcap_file import McapFile
from coded_aperture_ros.bags.names import METADATA, PACKED, SUFFIXES, storage_of
from coded_aperture_ros.bags.sqlite_file import SqliteFile
from coded_aperture_ros.bags.sqlite_recovery import leftovers, recovered
from coded_aperture_ros.core.errors import InputError

Part = McapFile | SqliteFile
# Compressed bytes that are read at once.
_BLOCK_BYTES = 2**16
_UNPACKED_BLOCK_BYTES = 2**20
# What an MCAP and an SQLite file begin with.
_MAGIC = (b"\x89MCAP", b"SQLite format 3")
# What is left to other programs on the disk of a copy.
_FREE_BYTES = 2**28
_KINDS: dict[str, type[Part]] = {"mcap": McapFile, "sqlite3": SqliteFile}


def open_parts(path: Path, resources: ExitStack) -> tuple[list[Part], list[str], Layout]:
    """Open the files of a bag, in the order of the recording.

    Parameters
    ----------
    path : Path
    resources : ExitStack
        Closes the files, and removes copies.

    Returns
    -------
    parts : list of Part
    damage : list of str
        Descriptions of what is wrong.
    layout : Layout

    Raises
    ------
    InputError
        If nothing in the bag can be read.
    """
    files, damage, layout = _files(path) if path.is_dir() else ([path], [], Layout())
    parts: list[Part] = []
    refused = damage[-1] if damage else ""
    for file in files:
        try:
            parts.append(_open_file(file, damage, resources))
        except PermissionError as error:
            raise InputError(f"cannot read {file}: {error.strerror}") from error
        except DAMAGE as error:
            refused = f"{file.name}: {one_line(error)}"
            damage.append(f"{file.name} cannot be read ({one_line(error)})")
    reasons = [refused, *(f"{part.path.name}: {part.damage}" for part in parts if part.damage)]
    damaged = damage or len(reasons) > 1
    if not parts or (damaged and not any(part.topics for part in parts)):
        reason = next(filter(None, reasons), "it has no topics")
        raise InputError(f"cannot read {path}: nothing in it can be read ({reason})")
    return parts, damage, layout


def _files(folder: Path) -> tuple[list[Path], list[str], Layout]:
    """Files of a bag in a folder, what is wrong with them, and their layout."""
    found = sorted((file.name for file in folder.iterdir() if storage_of(file.name)), key=by_number)
    layout = Layout()
    damage = []
    try:
        layout = read_layout(folder)
    except PermissionError as error:
        raise InputError(f"cannot read {folder}: {error.strerror}") from error
    except ValueError as error:
        damage.append(str(error))
    if not (folder / METADATA).exists():
        damage = [f"it has no {METADATA}, as if the recording was cut off"]
    names, more = _listed(found, layout.files) if layout.files else _alike(found)
    return [folder / name for name in names], damage + more, layout


def _listed(found: list[str], listed: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Files that the metadata lists, those that it should, and what is wrong."""
    damage = [f"{name} is missing" for name in listed if name not in found]
    added = []
    for name in found:
        if name in listed:
            continue
        twin = any(_twins(name, other) for other in listed if other in found)
        if twin or not same_recording(name, listed):
            damage.append(f"{name} is not in {METADATA}, and left out")
        else:
            damage.append(f"{name} is not in {METADATA}, but read")
            added.append(name)
    names = [name for name in listed if name in found]
    return (sorted([*names, *added], key=by_number) if added else names), damage


def _alike(found: list[str]) -> tuple[list[str], list[str]]:
    """Files of one storage, and which ones are left out."""
    storages = {storage_of(name) for name in found}
    storage = next((each for each in SUFFIXES.values() if each in storages), None)
    names: list[str] = []
    damage = []
    for name in found:
        twin = name.lower().endswith(PACKED) and any(_twins(name, other) for other in found)
        if twin or storage_of(name) != storage:
            damage.append(f"{name} is left out, beside {names[0] if names else found[0]}")
        else:
            names.append(name)
    return names, damage


def _twins(name: str, other: str) -> bool:
    """Whether two files are the same, one of them compressed."""
    return name != other and name.removesuffix(PACKED) == other.removesuffix(PACKED)


def _open_file(file: Path, damage: list[str], resources: ExitStack) -> Part:
    """Open a file, or what can be had of it as a copy; one of `DAMAGE` if it cannot be read."""
    if file.suffix.lower() == PACKED:
        file = _unpacked(file, damage, _temporary(resources))
    elif left := leftovers(file) if storage_of(file.name) == "sqlite3" else []:
        file, words = recovered(file, left, lambda: _temporary(resources))
        damage.append(words)
    part = _KINDS[storage_of(file.name) or "mcap"](file)
    resources.callback(part.close)
    return part


def _unpacked(file: Path, damage: list[str], folder: Path) -> Path:
    """Copy of a file that was compressed as a whole, up to where it is damaged."""
    copy = folder / file.stem
    left = most_unpacked(file.stat().st_size)
    with copy.open("wb") as output, file.open("rb") as packed:
        try:
            for part in _parts(packed):
                if part and not output.tell() and not part.startswith(_MAGIC):
                    damage.append(f"{file.name} holds no recording")
                    break
                left -= len(part)
                if left < 0 or shutil.disk_usage(folder).free < _FREE_BYTES + len(part):
                    reason = (
                        "it unpacks to more than a recording would" if left < 0 else "disk full"
                    )
                    damage.append(f"{file.name} is read in part ({reason})")
                    break
                output.write(part)
        except EOFError:
            damage.append(f"{file.name} is cut off")
        except zstd.ZstdError as error:
            damage.append(f"{file.name} is damaged ({one_line(error)})")
    return copy


def _parts(packed: BinaryIO) -> Iterator[bytes]:
    """Yield the content of a compressed file, in blocks; an `EOFError` if it is cut off."""
    decompressor = zstd.ZstdDecompressor()
    complete = False
    while block := packed.read(_BLOCK_BYTES):
        while block or not (decompressor.needs_input or decompressor.eof):
            yield decompressor.decompress(block, max_length=_UNPACKED_BLOCK_BYTES)
            complete = decompressor.eof
            block = decompressor.unused_data
            if complete:
                decompressor = zstd.ZstdDecompressor()
    if not complete:
        raise EOFError


def _temporary(resources: ExitStack) -> Path:
    """Temporary folder that goes with the bag."""
    return Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="coded_aperture_")))
