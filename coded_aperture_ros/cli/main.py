"""The program `coded_aperture`: one sub-command per module of this package.

A sub-command module has `add_parser(subparsers)` and `run(args) -> int`. What is slow to import,
it imports in `run`: `--help` must be quick.
"""

import argparse
import errno
import logging
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.extension import BENCH, VIEW
from coded_aperture_ros.cli.options import add_commands, show_late_options
from coded_aperture_ros.cli.version import ShowVersion
from coded_aperture_ros.core.blas import slow_blas_warning
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.interrupt import sigterm_like_ctrl_c

PROGRAM = "coded_aperture"
_BEGIN = "demo", "sample", "check", "calibrate", "mask", "learn"
_WORK = "depth", "deblur", "simulate", "bag"
COMMANDS: dict[str, Any] = {
    **{name: import_module(f"coded_aperture_ros.cli.{name}") for name in (*_BEGIN, *_WORK)},
    "view": VIEW,
    "bench": BENCH,
}

# What can go wrong where the output of a command goes.
_OF_OUTPUT = errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF
FAILED = 1
INTERRUPTED = 130  # what shells report for a program that Ctrl-C ended


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sub-command of some arguments, by default the process', and return its status.

    0: done, 1: failed (one line on stderr says why), 130: interrupted. Wrong usage raises
    `SystemExit` with status 2, after argparse has said what is wrong.
    """
    _set_up_libraries()
    _replace_closed_streams()
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format=f"{PROGRAM}: %(message)s")
    try:
        try:
            return _run(arguments)
        finally:
            sys.stdout.flush()
    except InputError as error:
        print(f"{PROGRAM}: error: {error}", file=sys.stderr)
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


def _run(arguments: Sequence[str] | None) -> int:
    parser = make_parser()
    if "_ARGCOMPLETE" in os.environ:  # a shell asks what may come next
        import argcomplete

        # It knows the values of those options only that are there when it begins.
        show_late_options(parser, os.environ.get("COMP_LINE", "").split())
        argcomplete.autocomplete(parser)
    options = parser.parse_args(arguments)
    if warning := slow_blas_warning():
        logging.warning(warning)
    with sigterm_like_ctrl_c():
        return COMMANDS[options.command].run(options)


def _replace_closed_streams() -> None:
    """Let streams that a shell has closed (`>&-`) be empty, or swallow what goes there."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115


def _set_up_libraries() -> None:
    """Choose what NumPy and OpenCV read when they are imported, unless the user has chosen."""
    # Its threads wait for each other actively: beside other work on the machine, learning a bank
    # takes ten times longer with them.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # What cannot be read we say ourselves, in one line.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description="Metric depth and all-in-focus frames from a single coded-aperture camera.",
        epilog=f"For a first look: '{PROGRAM} demo'. With a camera of your own: describe it in a "
        "camera file, learn its filter bank once, then use depth and deblur on its frames. "
        f"'{PROGRAM} COMMAND --help' shows a command's options and examples.",
    )
    what = "of the program and of what it runs on"
    parser.add_argument("--version", action=ShowVersion, nargs=0, help=what)
    add_commands(parser, "command", COMMANDS.values())
    return parser


if __name__ == "__main__":
    sys.exit(main())
