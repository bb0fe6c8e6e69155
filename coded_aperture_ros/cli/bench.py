"""`coded_aperture bench`: how accurate and how fast the methods are."""

import argparse
from importlib import import_module
from typing import Any

from coded_aperture_ros.cli.options import add_commands

BENCHMARKS: dict[str, Any] = {
    name: import_module(f"coded_aperture_ros.cli.bench_{name.replace('-', '_')}")
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


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "bench",
        help="measure accuracy on frames whose truth is known, and speed",
        description="Measure how good the methods are, on frames whose truth is known, and how "
        "fast.",
        epilog=_EPILOG,
    )
    add_commands(parser, "benchmark", BENCHMARKS.values())


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    status: int = BENCHMARKS[args.benchmark].run(args)
    return status
