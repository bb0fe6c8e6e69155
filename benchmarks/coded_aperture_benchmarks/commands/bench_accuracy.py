"""`coded_aperture bench accuracy`: how well blur and depth are identified."""

import argparse
from importlib import import_module
from typing import Any

from coded_aperture_ros.cli.options import add_commands

FRAMES: dict[str, Any] = {
    name: import_module(f"coded_aperture_benchmarks.commands.bench_{name.replace('-', '_')}")
    for name in ("stair", "two-plane", "simple", "scenes", "video")
}
_EPILOG = """examples:
  all of the thesis' masks we have, with and without regularisation:
    coded_aperture bench accuracy stair --masks two_hole four_hole annulus levin veeraraghavan \\
        zhou mura --methods bank bank-graphcut
  what happens at an occluding edge:
    coded_aperture bench accuracy two-plane
  masks of a few equal holes, next to table 5.1 of the thesis:
    coded_aperture bench accuracy simple
  metric depth of ray-traced scenes:
    coded_aperture bench accuracy scenes desk/ corridor/
  how much steadier the depth of a video is when it is filtered over time:
    coded_aperture bench accuracy video rendered/video/
"""


def add_parser(subparsers: Any) -> None:
    """Add the benchmark to the parser of `bench`."""
    parser = subparsers.add_parser(
        "accuracy",
        help="of blur identification and depth",
        description="Measure how well blur and depth are identified.",
        epilog=_EPILOG,
    )
    add_commands(parser, "frames", FRAMES.values())


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    status: int = FRAMES[args.frames].run(args)
    return status
