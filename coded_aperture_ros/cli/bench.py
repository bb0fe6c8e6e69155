"""`coded_aperture bench`: hands over to the benchmarks, which are not part of the package."""

import argparse
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from coded_aperture_ros.core.errors import InputError

_PACKAGE = "coded_aperture_benchmarks"


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "bench",
        help="measure accuracy on frames whose truth is known, and speed",
        add_help=False,  # the benchmarks' own help is the one that is wanted
        prefix_chars="\0",  # so that nothing is an option: the benchmarks parse them
    )
    parser.add_argument("arguments", nargs=argparse.REMAINDER)


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    status: int = of_benchmarks("__main__", "bench").main(args.arguments)
    return status


def of_benchmarks(module: str, what: str) -> Any:
    """Return a module of the benchmarks: installed, or those of the checkout we run from.

    `what` needs it, for messages. An `InputError` if they are not there.
    """
    if find_spec(_PACKAGE) is None:
        folder = Path(__file__).resolve().parents[2] / "benchmarks"
        if not (folder / _PACKAGE).is_dir():
            raise InputError(
                f"{what}: the benchmarks are not installed: in a checkout of the project, "
                "'pip install ./benchmarks'"
            )
        sys.path.append(str(folder))
    return import_module(f"{_PACKAGE}.{module}")
