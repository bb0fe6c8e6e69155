"""Output files: written whole or not at all, and checked before long work."""

import dataclasses
import errno
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.leftovers import remove_leftovers, temporary_name

# Files of the set that is being written, with what renames them; see `output_set`.
_set: ContextVar[list[tuple[Path, Path]] | None] = ContextVar("output_set", default=None)


@contextmanager
def atomic_output(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Temporary path beside `path`, which is renamed to `path` if the block succeeds.

    The block must write to the temporary path. Its name keeps the suffix, because encoders choose
    their format by it. Missing parent folders of `path` are created. A file that was there before
    leaves its permissions to the new one. The content is on the disk before the name is.

    Raises
    ------
    InputError
        If the folder cannot be created or written to, or the disk is full.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "new" / "words.txt"
    ...     with atomic_output(path) as temporary:
    ...         _ = temporary.write_text("all of it")
    ...     path.read_text()
    'all of it'
    """
    target = Path(path)
    renamed_later = _set.get()
    temporary = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(target.parent)
        temporary = _new_file(target)
        yield temporary
        with suppress(FileNotFoundError):
            temporary.chmod(target.stat().st_mode & 0o7777)
        flush(temporary)
        if renamed_later is None:
            temporary.replace(target)
            flush(target.parent)
        else:
            renamed_later.append((temporary, target))
    except OSError as error:
        raise InputError(f"cannot write {target}: {_reason(error)}") from error
    finally:
        is_kept = renamed_later is not None and (temporary, target) in renamed_later
        if temporary is not None and not is_kept:
            temporary.unlink(missing_ok=True)


@contextmanager
def output_set() -> Iterator[None]:
    """Let all files that `atomic_output` writes in the block appear at its end, or none of them.

    Sets may be within each other: the outermost counts.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder, output_set():
    ...     with atomic_output(Path(folder) / "a.txt") as temporary:
    ...         _ = temporary.write_text("a")
    ...     (Path(folder) / "a.txt").exists()
    False
    """
    if _set.get() is not None:
        yield
        return
    files: list[tuple[Path, Path]] = []
    token = _set.set(files)
    try:
        yield
        for temporary, target in files:
            try:
                temporary.replace(target)
            except OSError as error:
                raise InputError(f"cannot write {target}: {_reason(error)}") from error
        for folder in {target.parent for _, target in files}:
            flush(folder)
    finally:
        _set.reset(token)
        for temporary, _ in files:
            temporary.unlink(missing_ok=True)


def _new_file(target: Path) -> Path:
    """Empty file beside a target."""
    while True:
        temporary = target.parent / temporary_name(target.stem, target.suffix)
        with suppress(FileExistsError):
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            return temporary


def flush(path: Path) -> None:
    """Write a file, or the names in a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _reason(error: OSError) -> str:
    # NumPy says how many bytes it has written, and nothing else.
    return error.strerror or os.strerror(errno.ENOSPC if "requested" in str(error) else errno.EIO)


@contextmanager
def atomic_outputs() -> Iterator[Callable[[str | os.PathLike[str]], Path]]:
    """Several files written as by `atomic_output`; none appears before the block succeeds.

    Yields a function that takes the path of a file to create or replace, and returns the temporary
    path that the block must write to.

    Raises
    ------
    InputError
        As `atomic_output` does.
    """
    with output_set(), ExitStack() as files:
        yield lambda path: files.enter_context(atomic_output(path))


@dataclasses.dataclass(frozen=True)
class Outputs:
    """Where results go: to the output itself where it names a file, or else into a folder.

    Attributes
    ----------
    output : str
    suffix : str
        Of the files in a folder, which are named like their frames.
    suffixes : sequence of str
        What the name of a single file may end in.
    files : callable
        From the path of a result to those of all files that belong to it.
    read : sequence of Path
        Files that the command reads beside its inputs: they must not be overwritten.
    """

    output: str
    suffix: str
    suffixes: Sequence[str]
    files: Callable[[Path], Iterable[Path]]
    read: Sequence[Path]

    @property
    def is_file(self) -> bool:
        """Whether the output is a file, not a folder."""
        return _names_file(self.output)

    def path(self, name: str) -> Path:
        """Path of the result of a frame with a name."""
        return Path(self.output) if self.is_file else Path(self.output, f"{name}{self.suffix}")

    def check(self, total: int | None) -> None:
        """Raise `InputError` if so many frames, None: not known, cannot go there."""
        if not self.is_file:
            return
        if Path(self.output).suffix.lower() not in self.suffixes:
            known = ", ".join(self.suffixes)
            raise InputError(
                f"{self.output}: unknown format, use {known}, or end a folder's name with /"
            )
        if total != 1:
            raise InputError(
                f"{self.output}: {'several' if total is None else total} frames do not fit into "
                "one file, name a folder"
            )


def _names_file(path: str | os.PathLike[str]) -> bool:
    """Whether an output is a file, not a folder: it has a suffix."""
    return bool(Path(path).suffix) and not str(path).endswith("/") and not Path(path).is_dir()


def check_suffix(path: str | os.PathLike[str], suffixes: Sequence[str]) -> None:
    """Raise an `InputError` unless an output's name ends in one of the suffixes."""
    if Path(path).suffix.lower() not in suffixes:
        raise InputError(f"{path}: unknown format, use a name that ends in {' or '.join(suffixes)}")


def check_folder(path: str | os.PathLike[str]) -> None:
    """Raise an `InputError` if the folder of an output file does not exist; folders are made."""
    if not _names_file(path):
        return
    target = Path(path)
    existing = next((each for each in target.parents if each.exists()), target.parent)
    # That a file has the name of a folder is told by `check_output`.
    if existing.is_dir() and existing != target.parent:
        raise InputError(
            f"cannot write {target}: there is no folder {target.parent}: make it, or add --parents"
        )


def check_output(
    paths: str | os.PathLike[str] | Iterable[Path],
    inputs: Iterable[Path] = (),
    suffixes: Sequence[str] = (),
    others: Iterable[Path] = (),
) -> None:
    """Check that one file or several can be written, without writing them.

    Parameters
    ----------
    paths : path or iterable of path
    inputs : iterable of Path
        Existing files that must not be overwritten.
    suffixes : sequence of str
        As of `check_suffix`; empty: any.
    others : iterable of Path
        Outputs that were checked before.

    Raises
    ------
    InputError
        If one cannot be written.
    """
    taken = {*map(_identity, inputs)} - {None}
    written = {path.resolve() for path in others}
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
            # Permissions alone are not enough: the file system may be read-only.
            tempfile.TemporaryFile(dir=folder).close()
        except OSError as error:
            raise InputError(f"cannot write {path}: {folder}: {error.strerror or error}") from error


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and inode of a file, the same for all of its names; None if it does not exist."""
    return (path.stat().st_dev, path.stat().st_ino) if path.exists() else None
