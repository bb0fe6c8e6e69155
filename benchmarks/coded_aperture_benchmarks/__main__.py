"""The benchmarks' command line, which `coded_aperture bench` hands its arguments to."""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from coded_aperture_ros.cli.options import CommandParser, add_commands

BENCHMARKS: dict[str, Any] = {
    name: import_module(f"coded_aperture_benchmarks.commands.bench_{name.replace('-', '_')}")
    for name in (
        "accuracy",
        "deblur",
        "speed",
        "simple-speed",
        "motion",
        "masks",
        "sign",
        "blind",
    )
}
_EPILOG = """examples:
  blur identification on the thesis' stair of blur sizes, next to the numbers of the thesis:
    coded_aperture bench accuracy stair
  all-in-focus frames of ray-traced scenes, next to other methods of deblurring:
    coded_aperture bench deblur scenes desk/ corridor/
  time of a frame and of its stages, next to what the machine could do and to other methods:
    coded_aperture bench speed
  the same for masks of a few equal holes:
    coded_aperture bench simple-speed
  defocus and motion together:
    coded_aperture bench motion table
  predicted against measured errors of random masks:
    coded_aperture bench masks
  both sides of the focal plane:
    coded_aperture bench sign
  masks found from planes at unknown distances:
    coded_aperture bench blind
  what each benchmark is, and its options:
    coded_aperture bench accuracy --help
"""


def make_parser(program: str) -> argparse.ArgumentParser:
    """Return the parser of all benchmarks."""
    parser = CommandParser(
        prog=program,
        description="Measure how good the methods are, on frames whose truth is known, and how "
        "fast.",
        epilog=_EPILOG,
    )
    add_commands(parser, "benchmark", BENCHMARKS.values())
    return parser


def main(arguments: Sequence[str] | None = None, program: str = "coded_aperture bench") -> int:
    """Run one benchmark; return its exit status."""
    args = make_parser(program).parse_args(arguments)
    status: int = BENCHMARKS[args.benchmark].run(args)
    return status


if __name__ == "__main__":
    sys.exit(main())
