"""The benchmarks' command line, which `coded_aperture bench` hands its arguments to."""

import argparse
import dataclasses
import logging
import os
import sys
import textwrap
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

from coded_aperture_benchmarks.run import run
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.interrupt import sigterm_like_ctrl_c


@dataclasses.dataclass(frozen=True)
class Group:
    """Benchmarks of one kind: the help of each, by its name."""

    help: str
    description: str
    examples: str
    suites: Mapping[str, str]


_ACCURACY = Group(
    help="of blur identification and depth",
    description="Measure how well blur and depth are identified.",
    examples="""examples:
  all of the thesis' masks we have, with and without regularisation:
    coded_aperture bench accuracy stair --masks two_hole four_hole annulus levin veeraraghavan \\
        zhou mura --methods bank bank-graphcut
  what happens at an occluding edge:
    coded_aperture bench accuracy two-plane
  masks of a few equal holes, next to table 5.1 of the thesis:
    coded_aperture bench accuracy simple
  metric depth of ray-traced scenes:
    coded_aperture bench accuracy scenes desk/ corridor/
  pictures of other kinds with measured depth:
    coded_aperture bench accuracy pictures data/
  how much less the depth of a video flickers when it is filtered over time:
    coded_aperture bench accuracy video rendered/video/
""",
    suites={
        "stair": "a stair of blur sizes, as in the thesis",
        "two-plane": "two planes, one before the other",
        "simple": "planes behind masks of a few equal holes",
        "scenes": "ray-traced scenes with true depth",
        "pictures": "pictures with measured depth, behind many masks",
        "video": "videos with true depth, filtered over time",
    },
)
_DEBLUR = Group(
    help="quality of the all-in-focus frames, and speed",
    description="Measure how good all-in-focus frames are, beside those of other methods, and how "
    "long they take.",
    examples="""examples:
  the thesis' stair of blur sizes, next to the numbers of the thesis:
    coded_aperture bench deblur stair
  ray-traced scenes, by the true and by the estimated depth, with pictures:
    coded_aperture bench deblur scenes desk/ corridor/ --output results/
  a photograph of a flat page, whose PSF was measured:
    coded_aperture bench deblur photograph real_photo/
  how long a frame takes:
    coded_aperture bench deblur speed
""",
    suites={
        "stair": "a stair of blur sizes, as in the thesis",
        "scenes": "ray-traced scenes with a true all-in-focus frame",
        "photograph": "a photograph of a flat page, with its measured PSF",
        "speed": "how long a frame takes",
    },
)
_MOTION = Group(
    help="of depth and deblurring while things move",
    description="Measure how well defocus and motion are distinguished, and what it costs.",
    examples="""examples:
  table 7.1 of the thesis, and natural texture:
    coded_aperture bench motion table
  depth and all-in-focus frames of scenes in which an object moves:
    coded_aperture bench motion scenes --deblur cg
  time of a frame, with and without motion, and with what a gyroscope knows:
    coded_aperture bench motion speed
""",
    suites={
        "table": "planes that move, as in the thesis",
        "scenes": "an object that moves in front of a scene that does not",
        "speed": "time of a frame with and without motion",
    },
)
# By name a group, or a benchmark's help. A suite's module has its name, below a group that of the
# group too; those of `accuracy` came first.
BENCHMARKS: dict[str, Group | str] = {
    "accuracy": _ACCURACY,
    "deblur": _DEBLUR,
    "speed": "of depth: stages, roofline, scaling, other methods",
    "simple-speed": "of depth behind masks of a few equal holes",
    "motion": _MOTION,
    "masks": "predicted against measured errors of random masks",
    "subspaces": "how far apart the subspaces of levels lie, as in the thesis",
    "sign": "the side of the focal plane: in front or behind",
    "trust": "what is made of frames that do not fit their bank",
    "fitting": "frames that fit their bank, and videos whose light changes",
    "datasheet": "what the data sheet of a camera would say",
    "lens": "a real lens: before and after its field curvature is measured",
    "free-space": "a bound that what is seen is hardly ever nearer than, and what it costs",
    "second": "two surfaces in one window: nets, leaves and panes before something",
    "focus": "two frames at two focus settings, beside one",
    "odometry": "how far a robot drifts that steers by these frames alone",
    "tags": "over what distances tags and QR codes are read",
    "views": "the view through each opening of the mask, and focus after the shot",
    "blind": "masks found from planes at unknown distances, and what deblurring loses by them",
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
  distances between subspaces, next to those of the thesis:
    coded_aperture bench subspaces
  both sides of the focal plane:
    coded_aperture bench sign
  frames that do not fit their bank:
    coded_aperture bench trust desk/ chess/
  frames that fit, and what is said of them:
    coded_aperture bench fitting desk/ video/
  the data sheet of a camera:
    coded_aperture bench datasheet --camera config/demo_camera.yaml --depth-range 2.1 5.1
  a real lens, measured with planes:
    coded_aperture bench lens desk/ --planes calib/
  how often something is nearer than the bound on free space:
    coded_aperture bench free-space
  what is seen through nets and leaves:
    coded_aperture bench second
  two frames at two focus settings:
    coded_aperture bench focus
  the way of a camera through a room, found by its frames alone:
    coded_aperture bench odometry --rooms 1 --length 2
  tags and QR codes at random distances, beside an ordinary lens:
    coded_aperture bench tags
  views through each opening of the mask:
    coded_aperture bench views
  masks found from planes at unknown distances:
    coded_aperture bench blind
  what each benchmark is, and its options:
    coded_aperture bench accuracy --help
"""


class BenchmarkParser(argparse.ArgumentParser):
    """Parser of a benchmark, which reads its suite once it is the one that was chosen."""

    suite: str | None = None  # the module of its suite

    def __init__(self, *, description: str = "", **others: Any) -> None:
        super().__init__(
            description=textwrap.fill(description, 79),
            formatter_class=argparse.RawDescriptionHelpFormatter,  # examples keep their lines
            **others,
        )
        # For what only the values of several options together can tell.
        self.set_defaults(usage_error=self.error)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Add the suite's options, then parse; see `argparse.ArgumentParser`."""
        if self.suite is not None:
            suite = import_module(f"coded_aperture_benchmarks.suites.{self.suite}").SUITE
            self.suite = None
            self.description = textwrap.fill(suite.description, 79)
            self.epilog = suite.examples
            for add in suite.options:
                add(self)
            self.set_defaults(suite=suite)
        return super().parse_known_args(args, namespace)


def make_parser(program: str) -> argparse.ArgumentParser:
    """Return the parser of all benchmarks; a suite is imported once it was chosen."""
    parser = BenchmarkParser(
        prog=program,
        description="Measure how good the methods are, on frames whose truth is known, and how "
        "fast.",
        epilog=_EPILOG,
    )
    chosen = _choice(parser, "benchmark")
    for name, described in BENCHMARKS.items():
        if isinstance(described, str):
            _add_suite(chosen, name, name, described)
            continue
        group = chosen.add_parser(
            name, help=described.help, description=described.description, epilog=described.examples
        )
        frames = _choice(group, "frames")
        prefix = "" if described is _ACCURACY else f"{name}_"
        for suite, what in described.suites.items():
            _add_suite(frames, suite, prefix + suite, what)
    return parser


def _choice(parser: argparse.ArgumentParser, dest: str) -> Any:
    return parser.add_subparsers(
        dest=dest, metavar=dest.upper(), required=True, parser_class=BenchmarkParser
    )


def _add_suite(subparsers: Any, name: str, module: str, what: str) -> None:
    parser = subparsers.add_parser(name, help=what)
    parser.suite = module.replace("-", "_")


def main(arguments: Sequence[str] | None = None, program: str = "coded_aperture bench") -> int:
    """Run one benchmark; return its exit status."""
    args = make_parser(program).parse_args(arguments)
    return run(args.suite, args)


def _main_of_this_package() -> int:
    """Run one benchmark; what goes wrong is one line."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    program = "python -m coded_aperture_benchmarks"
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(message)s")
    try:
        with sigterm_like_ctrl_c():
            return main(program=program)
    except InputError as error:
        print(f"{program}: error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(_main_of_this_package())
