"""`coded_aperture bench motion`: motion and defocus together."""

import argparse
from importlib import import_module
from typing import Any

from coded_aperture_ros.cli.options import add_commands

FRAMES: dict[str, Any] = {
    name: import_module(f"coded_aperture_benchmarks.commands.bench_motion_{name}")
    for name in ("table", "scenes", "speed")
}
_EPILOG = """examples:
  table 7.1 of the thesis, and natural texture:
    coded_aperture bench motion table
  depth and all-in-focus frames of scenes in which an object moves:
    coded_aperture bench motion scenes --deblur cg
  time of a frame, with and without motion, and with what a gyroscope knows:
    coded_aperture bench motion speed
"""


def add_parser(subparsers: Any) -> None:
    """Add the benchmark to the parser of `bench`."""
    parser = subparsers.add_parser(
        "motion",
        help="of depth and deblurring while things move",
        description="Measure how well defocus and motion are told apart, and what it costs.",
        epilog=_EPILOG,
    )
    add_commands(parser, "frames", FRAMES.values())


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    status: int = FRAMES[args.frames].run(args)
    return status
