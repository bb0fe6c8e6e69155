"""The program `coded_aperture`: runs the command that is typed, and says what goes wrong."""

import errno
import io
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from coded_aperture_ros.cli.command import UsageError
from coded_aperture_ros.cli.commands import COMMANDS
from coded_aperture_ros.cli.table import Actions
from coded_aperture_ros.core.blas import set_blas_variables, slow_blas_warning
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.interrupt import sigterm_like_ctrl_c
from coded_aperture_ros.core.text import shortened

PROGRAM = "coded_aperture"
# What can go wrong where the output of a command goes.
_OF_OUTPUT = errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF
# Characters of a message; what files of strangers name themselves may be longer.
_LONGEST_MESSAGE = 2000
FAILED = 1
WRONG_USAGE = 2
INTERRUPTED = 130  # what shells report for a program that Ctrl-C ended


def main(words: Sequence[str] | None = None) -> int:
    """Run the command of some words, by default those of the process; return its exit status.

    0: done, 1: failed, 2: wrong usage, 130: interrupted. One line on stderr says what failed.
    Help that was printed raises `SystemExit` with status 0.
    """
    _set_up_libraries()
    _replace_closed_streams()
    _print_any_name()
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format=f"{PROGRAM}: %(message)s")
    try:
        try:
            return _run(sys.argv[1:] if words is None else words)
        finally:
            sys.stdout.flush()
    except InputError as error:
        print(f"{PROGRAM}: error: {shortened(str(error), _LONGEST_MESSAGE)}", file=sys.stderr)
        return FAILED
    except (MemoryError, OverflowError, RecursionError) as error:
        # An input that asks for more than any has; what it is, our own checks know better.
        what = "not enough memory" if isinstance(error, MemoryError) else "a number is too large"
        print(f"{PROGRAM}: error: {what}: an input is too large, or damaged", file=sys.stderr)
        return FAILED
    except OSError as error:
        if error.filename is not None or error.errno not in _OF_OUTPUT:
            raise
        if not isinstance(error, BrokenPipeError):  # else whoever read our output has left
            print(f"{PROGRAM}: error: cannot write the output: {error.strerror}", file=sys.stderr)
        # Python's own flush at exit would complain about it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except KeyboardInterrupt:
        return INTERRUPTED


def program_of(commands: dict[str, object]) -> Actions:
    """Return the program as a command whose actions are the commands."""
    return Actions(
        help="",
        description="Metric depth and all-in-focus frames from a single coded-aperture camera.",
        examples=f"For a first look: '{PROGRAM} demo'. With a camera of your own: describe it in "
        "a camera file,\nlearn its filter bank once, then use depth and deblur on its frames. "
        f"'{PROGRAM} COMMAND --help' shows\na command's options and examples.",
        actions=commands,
        placeholder="COMMAND",
    )


def _run(words: Sequence[str]) -> int:
    if "_ARGCOMPLETE" in os.environ:  # a shell asks what may come next
        from coded_aperture_ros.cli.completion import complete

        complete(PROGRAM, COMMANDS)
    if words and words[0] == "--version":
        from coded_aperture_ros.cli.version import print_version

        print_version(PROGRAM)
        return 0
    program = PROGRAM
    try:
        program, command, rest = program_of(COMMANDS).choose(PROGRAM, words)
        ready = command.prepare(program, rest)
        if warning := slow_blas_warning():
            logging.warning(warning)
        with sigterm_like_ctrl_c():
            return int(ready())
    except UsageError as error:
        program = error.program or program
        print(f"{program}: error: {error}; see '{program} --help'", file=sys.stderr)
        return WRONG_USAGE


def _replace_closed_streams() -> None:
    """Let streams that a shell has closed (`>&-`) be empty, or swallow what goes there."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115


def _print_any_name() -> None:
    r"""Let names of files that are no Unicode be printed, as \udcff for the byte 255."""
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")


def _set_up_libraries() -> None:
    """Choose what NumPy and OpenCV read when they are imported, unless the user has chosen."""
    set_blas_variables()
    # What cannot be read we say ourselves, in one line.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")


if __name__ == "__main__":
    sys.exit(main())
