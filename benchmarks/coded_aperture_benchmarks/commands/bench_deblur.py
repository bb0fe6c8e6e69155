"""`coded_aperture bench deblur`: the quality of all-in-focus frames, and their time."""

import argparse
from importlib import import_module
from typing import Any

from coded_aperture_ros.cli.options import add_commands

FRAMES: dict[str, Any] = {
    name: import_module(f"coded_aperture_benchmarks.commands.bench_deblur_{name}")
    for name in ("stair", "scenes", "photograph", "speed")
}
_EPILOG = """examples:
  the thesis' stair of blur sizes, next to the numbers of the thesis:
    coded_aperture bench deblur stair
  ray-traced scenes, by the true and by the estimated depth, with pictures:
    coded_aperture bench deblur scenes desk/ corridor/ --output results/
  a photograph of a flat page, whose PSF was measured:
    coded_aperture bench deblur photograph real_photo/
  how long a frame takes:
    coded_aperture bench deblur speed
"""


def add_parser(subparsers: Any) -> None:
    """Add the benchmark to the parser of `bench`."""
    parser = subparsers.add_parser(
        "deblur",
        help="quality of the all-in-focus frames, and speed",
        description="Measure how good all-in-focus frames are, beside those of other "
        "methods, and how long they take.",
        epilog=_EPILOG,
    )
    add_commands(parser, "frames", FRAMES.values())


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    status: int = FRAMES[args.frames].run(args)
    return status
