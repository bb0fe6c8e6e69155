"""The benchmarks' command line: all of them; some are commands of `coded_aperture bench` too."""

import argparse
import logging
import os
import sys
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from coded_aperture_benchmarks.registry import BENCHMARKS, OF_THE_PROGRAM, Entry, Group
from coded_aperture_benchmarks.run import run
from coded_aperture_ros.core.blas import set_blas_variables
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.interrupt import sigterm_like_ctrl_c

PROGRAM = "python -m coded_aperture_benchmarks"
FAILED = 1
INTERRUPTED = 130
_EPILOG = """examples:
  blur identification on the thesis' stair of blur sizes, next to the numbers of the thesis:
    {program} accuracy stair
  all-in-focus frames of ray-traced scenes, next to other methods of deblurring:
    {program} deblur scenes desk/ corridor/
  what a benchmark is, its options and examples:
    {program} accuracy scenes --help
"""


class BenchmarkParser(argparse.ArgumentParser):
    """Parser of a benchmark, which reads its suite once it is the one that was chosen."""

    entry: Entry | None = None

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
        if self.entry is not None:
            suite = self.entry.load()
            self.entry = None
            self.description = textwrap.fill(suite.description, 79)
            self.epilog = suite.examples
            for add in suite.options:
                add(self)
            self.set_defaults(suite=suite)
        return super().parse_known_args(args, namespace)


def make_parser(
    program: str = PROGRAM, benchmarks: Mapping[str, Group | Entry] = BENCHMARKS
) -> argparse.ArgumentParser:
    """Return the parser of some benchmarks."""
    parser = BenchmarkParser(
        prog=program,
        description="Measure how good the methods are, on frames whose truth is known, and how "
        "fast.",
        epilog=_EPILOG.format(program=program),
    )
    chosen = _choice(parser, "benchmark")
    for name, described in benchmarks.items():
        if isinstance(described, Entry):
            _add_suite(chosen, name, described)
            continue
        one = next(iter(described.suites))
        group = chosen.add_parser(
            name,
            help=described.help,
            description=described.description,
            epilog=f"examples:\n  {program} {name} {one} --help",
        )
        frames = _choice(group, "frames")
        for suite, entry in described.suites.items():
            _add_suite(frames, suite, entry)
    return parser


def _choice(parser: argparse.ArgumentParser, dest: str) -> Any:
    return parser.add_subparsers(
        dest=dest, metavar=dest.upper(), required=True, parser_class=BenchmarkParser
    )


def _add_suite(subparsers: Any, name: str, entry: Entry) -> None:
    subparsers.add_parser(name, help=entry.help).entry = entry


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one of the benchmarks that `coded_aperture bench` offers; return its exit status."""
    words = sys.argv[1:] if arguments is None else arguments
    if words and words[0] in BENCHMARKS and words[0] not in OF_THE_PROGRAM:
        raise InputError(f"bench {words[0]}: use '{PROGRAM} {words[0]}'")
    args = make_parser("coded_aperture bench", OF_THE_PROGRAM).parse_args(words)
    return run(args.suite, args)


def main_of_all(arguments: Sequence[str] | None = None) -> int:
    """Run any benchmark; return its exit status. What goes wrong is one line."""
    # NumPy and OpenCV read these when they are imported.
    set_blas_variables()
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(message)s")
    try:
        with sigterm_like_ctrl_c():
            args = make_parser().parse_args(arguments)
            return run(args.suite, args)
    except InputError as error:
        print(f"{PROGRAM}: error: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main_of_all())
