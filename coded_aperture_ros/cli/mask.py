"""`coded_aperture mask`: what can be done with a mask before it is in a lens."""

import argparse
from typing import Any

from coded_aperture_ros.cli import mask_print
from coded_aperture_ros.cli.extension import MASK_DESIGN, MASK_MOTION, MASK_SCORE, MASK_SEARCH
from coded_aperture_ros.cli.options import add_commands

ACTIONS: dict[str, Any] = {
    "print": mask_print,
    "score": MASK_SCORE,
    "search": MASK_SEARCH,
    "design": MASK_DESIGN,
    "motion": MASK_MOTION,
}
_EPILOG = """examples:
  Levin's mask, 26 mm wide, on a page to be printed and cut out:
    coded_aperture mask print levin --extent-mm 26 -o mask.pdf
  what errors to expect of all masks with names:
    coded_aperture mask score
"""


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "mask",
        help="print a mask at true scale, score masks, search for better ones",
        description="Print the mask of an aperture at true scale, predict how good masks are, "
        "search for better ones, or find one for a camera and its range, or for what moves.",
        epilog=_EPILOG,
    )
    add_commands(parser, "action", ACTIONS.values())


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    return ACTIONS[args.action].run(args)
