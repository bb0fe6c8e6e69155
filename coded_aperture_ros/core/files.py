"""Writing files so that a reader never sees half of one."""

import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from coded_aperture_ros.core.errors import InputError


@contextmanager
def atomic_output(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it to `path` if the block succeeds.

    The block must write to the temporary path, whose name keeps the suffix, because encoders choose
    their format by it. Missing parent folders of `path` are created. Raises `InputError` if the
    folder cannot be created or written to, or the disk is full.
    """
    target = Path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            dir=target.parent, prefix=f".{target.stem}-", suffix=target.suffix
        )
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror or error}") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        _give_usual_permissions(temporary)
        temporary.replace(target)
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_outputs() -> Iterator[Callable[[str | os.PathLike[str]], Path]]:
    """Yield `atomic_output` for several files, none of which appears before the block succeeds.

    What is yielded gets the file to create or replace, and returns where the block must write it.
    Raises `InputError` as `atomic_output` does.
    """
    with ExitStack() as files:
        yield lambda path: files.enter_context(atomic_output(path))


@contextmanager
def temporary_folder(path: Path) -> Iterator[Path]:
    """Yield a folder beside `path`, and remove it in the end, with parents made for it."""
    made = [parent for parent in path.absolute().parents if not parent.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        temporary = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}-"))
        try:
            yield temporary
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    finally:
        if not path.exists():
            for parent in made:
                with suppress(OSError):
                    parent.rmdir()


def _give_usual_permissions(path: Path) -> None:
    # mkstemp makes files private; an output file should obey the user's umask like any other.
    umask = os.umask(0)
    os.umask(umask)
    path.chmod(0o666 & ~umask)


def check_suffix(path: str | os.PathLike[str], suffixes: Sequence[str]) -> None:
    """Raise an `InputError` unless an output's name ends in one of the formats to write."""
    if Path(path).suffix.lower() not in suffixes:
        raise InputError(f"{path}: unknown format, use a name that ends in {' or '.join(suffixes)}")


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
