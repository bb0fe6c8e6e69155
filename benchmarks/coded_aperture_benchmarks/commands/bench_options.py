"""Options that the benchmarks share, and how they write their results."""

import argparse
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_methods import method_names
from coded_aperture_ros.cli.checks import check_output
from coded_aperture_ros.cli.options import (
    add_jobs_option,
    add_sigmas_option,
    at_least,
    mask_of,
    noise_level,
)
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.core.threads import processors

RESULTS = "results.json"


def texture_and_noise(textures: Sequence[str]) -> Callable[[str], tuple[str, float]]:
    """Return a parser of TEXTURE,S for argparse: a texture's name, and noise."""

    def parse(text: str) -> tuple[str, float]:
        texture, _, sigma = text.partition(",")
        if texture not in textures:
            raise argparse.ArgumentTypeError(
                f"expected one of {', '.join(textures)}, got {texture!r}"
            )
        return texture, noise_level(sigma)

    parse.__name__ = "texture and noise"  # argparse says "invalid texture and noise value"
    return parse


def frame_size(text: str) -> tuple[int, int]:
    """Parse WxH; return rows and columns."""
    width, times, height = text.lower().partition("x")
    if not (times and width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"expected a size like 640x480, got {text!r}")
    return int(height), int(width)


def add_size_option(parser: argparse.ArgumentParser, size: tuple[int, int]) -> None:
    """Add the size of the frames; `size` is the default, rows and columns."""
    parser.add_argument(
        "--size",
        type=frame_size,
        default=size,
        metavar="WxH",
        help=f"of the frames, px (default {size[1]}x{size[0]})",
    )


def add_threads_option(parser: argparse.ArgumentParser) -> None:
    """Add how many threads work on a frame."""
    parser.add_argument(
        "--threads",
        type=at_least(1),
        default=processors(),
        metavar="N",
        help=f"threads of the processor (default: all, here {processors()})",
    )


def add_cell_options(
    parser: argparse.ArgumentParser,
    sigmas: Sequence[float],
    repeats: int,
    methods: Sequence[str],
    window_px: int,
    rank: int,
) -> None:
    """Add the options of the benchmarks that make their own frames."""
    add_masks_option(parser, ("four_hole", "levin"))
    add_sigmas_option(parser, sigmas)
    parser.add_argument(
        "--methods",
        nargs="+",
        default=list(methods),
        metavar="METHOD",
        help="bank (not regularised), bank-tv and so on (see --regularize of the command depth), "
        "plain-48 (bank with a bare window of 48 px), subspace (the thesis' own), simple and "
        "simple-tv and so on (masks of a few equal holes), conditional (their data term in the "
        "thesis), wiener, levin "
        "and other reference methods; an unknown name lists them all "
        f"(default {' '.join(methods)})",
    )
    parser.add_argument(
        "--repeats",
        type=at_least(1),
        default=repeats,
        metavar="N",
        help=f"frames with other crops and noise to take the mean over (default {repeats})",
    )
    parser.add_argument(
        "--seed", type=at_least(0), default=0, metavar="N", help="of the first repeat (default 0)"
    )
    parser.add_argument(
        "--levels",
        type=at_least(2),
        default=39,
        metavar="N",
        help="blur sizes, equally spaced from 7 to 30 px (default 39)",
    )
    parser.add_argument(
        "--window",
        type=at_least(16),
        default=window_px,
        metavar="PX",
        help=f"side of the bank's patches (default {window_px})",
    )
    parser.add_argument(
        "--rank",
        type=at_least(1),
        default=rank,
        metavar="R",
        help=f"vectors in the bank's common basis (default {rank})",
    )
    parser.add_argument(
        "--stride",
        type=at_least(1),
        metavar="PX",
        help="distance between the bank's patches (default: as the command depth)",
    )
    add_picture_options(parser)
    add_result_options(parser)


def add_cases_option(
    parser: argparse.ArgumentParser,
    textures: Sequence[str],
    cases: Sequence[tuple[str, float]],
    share: str,
) -> None:
    """Add pairs of texture and noise to measure with; `share` is the part that masks let pass."""
    parser.add_argument(
        "--cases",
        nargs="+",
        type=texture_and_noise(textures),
        default=list(cases),
        metavar="TEXTURE,S",
        help=f"texture ({', '.join(textures)}) and noise behind an open aperture, which is "
        f"divided by the {share} "
        f"(default {' '.join(f'{texture},{sigma:g}' for texture, sigma in cases)})",
    )


def add_masks_option(parser: argparse.ArgumentParser, masks: Sequence[str]) -> None:
    """Add the masks to measure with."""
    parser.add_argument(
        "--masks",
        nargs="+",
        default=list(masks),
        metavar="MASK",
        help=f"names or files (default {' '.join(masks)})",
    )


def add_images_option(parser: argparse.ArgumentParser) -> None:
    """Add which pictures are the textures; see `folder_of`."""
    parser.add_argument(
        "--images", metavar="DIR", help="pictures of this folder instead of the built-in ones"
    )


def add_picture_options(parser: argparse.ArgumentParser) -> None:
    """Add which pictures are the textures, and whether the noise in them is told."""
    add_images_option(parser)
    parser.add_argument(
        "--known-noise",
        action="store_true",
        help="tell the methods of this project the noise; by default they estimate it in each "
        "frame",
    )


def add_result_options(parser: argparse.ArgumentParser) -> None:
    """Add what all benchmarks of accuracy have."""
    add_jobs_option(parser)
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    parser.add_argument("--output", metavar="DIR", help=f"write {RESULTS} and figures (PNG)")


def check_cell_options(args: argparse.Namespace) -> None:
    """Refuse what cannot be measured before anything is.

    Raises
    ------
    InputError
        If a mask is unknown or unreadable.
    """
    for method in args.methods:
        if method not in method_names():
            args.usage_error(
                f"--methods: unknown method {method!r}, use some of {', '.join(method_names())}"
            )
    if args.window % 2:
        args.usage_error(f"--window: expected an even number, got {args.window}")
    for mask in args.masks:
        mask_of(mask)
    check_result_options(args)


def check_result_options(args: argparse.Namespace) -> None:
    """Find out before an hour of work whether its results can be written.

    Raises
    ------
    InputError
        If they cannot.
    """
    if args.output is None:
        return
    if Path(args.output).is_file():
        raise InputError(f"cannot write {args.output}: it is a file, expected a folder")
    check_output(Path(args.output) / RESULTS)
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise InputError(
            "--output: figures need matplotlib: pip install matplotlib, or use --json"
        ) from error


def report(
    args: argparse.Namespace,
    results: dict[str, Any],
    text: Callable[[], str],
    draw: Callable[[Path], None] | None = None,
) -> None:
    """Write and print the results in the forms that were asked for.

    Parameters
    ----------
    args : argparse.Namespace
        With `json` and `output`.
    results : dict
        NaN becomes null.
    text : callable
        Returns the results as tables.
    draw : callable, optional
        Draws figures into a folder. Tables that are small enough to be read have none.
    """
    as_json = json.dumps(_without_nan(results), indent=1, allow_nan=False)
    folder = None if args.output is None else Path(args.output)
    if folder is not None:
        with atomic_output(folder / RESULTS) as path:
            path.write_text(as_json + "\n")
    if args.json:
        print(as_json)
    if folder is not None and draw is not None:
        draw(folder)
    if not args.json:
        print(text())
        if folder is not None:
            print(f"{'figures and ' if draw else ''}{RESULTS}: {folder}")


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
