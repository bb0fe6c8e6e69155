"""What can be checked before anything is computed."""

import argparse
import os
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from coded_aperture_ros.core.errors import InputError


def check_suffix(path: str | os.PathLike[str], suffixes: Sequence[str]) -> None:
    """Raise an `InputError` unless an output's name ends in one of the formats to write."""
    if Path(path).suffix.lower() not in suffixes:
        raise InputError(f"{path}: unknown format, use a name that ends in {' or '.join(suffixes)}")


def inputs_of(args: argparse.Namespace, *names: str) -> list[Path]:
    """Return the files that options give to read, and what a camera file among them names."""
    from coded_aperture_ros.optics.camera_file import camera_files

    given = {name: value for name in names if isinstance(value := getattr(args, name, None), str)}
    camera = given.pop("camera", None)
    return [*map(Path, given.values()), *(camera_files(camera) if camera else ())]


def input_files(*paths: str | None, camera: str | None = None) -> list[Path]:
    """Return the files that are read, of those that are given: also what a camera file names."""
    from coded_aperture_ros.optics.camera_file import camera_files

    given = [Path(path) for path in paths if path]
    return [*given, *(camera_files(camera) if camera else ())]


def check_output(
    paths: str | os.PathLike[str] | Iterable[Path],
    inputs: Iterable[Path] = (),
    suffixes: Sequence[str] = (),
    others: Iterable[Path] = (),
) -> None:
    """Check that a file, or several, can be written, without writing them.

    An `InputError` says why one cannot, and what to do instead; where it is one of the existing
    files `inputs`, that it must not be overwritten. `suffixes` are those of
    `check_suffix`, if any. `others` are outputs that were checked before.
    """
    taken, written = {*map(_identity, inputs)} - {None}, {path.resolve() for path in others}
    for path in [Path(paths)] if isinstance(paths, (str, os.PathLike)) else paths:
        if suffixes:
            check_suffix(path, suffixes)
        if (resolved := path.resolve()) in written:
            what = "two results cannot go to one file: use another name, or a folder for each input"
            raise InputError(f"{path}: {what}")
        written.add(resolved)
        if path.is_dir():
            raise InputError(f"cannot write {path}: it is a folder")
        if _identity(path) in taken:
            raise InputError(
                f"{path}: this is an input, and would be overwritten: use another name or folder"
            )
        folder = next(each for each in path.parents if each.exists() or each == each.parent)
        if not folder.is_dir():
            raise InputError(f"cannot write {path}: {folder} is not a folder")
        try:
            # Permissions alone do not tell: a file system may be read-only.
            tempfile.TemporaryFile(dir=folder).close()
        except OSError as error:
            raise InputError(f"cannot write {path}: {folder}: {error.strerror or error}") from error


def _identity(path: Path) -> tuple[int, int] | None:
    """Return what a file is told from others by, whatever they are called, if it exists."""
    return (path.stat().st_dev, path.stat().st_ino) if path.exists() else None
