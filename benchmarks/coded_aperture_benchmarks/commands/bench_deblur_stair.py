"""`coded_aperture bench deblur stair`: the error of deblurring of thesis 6.3.1."""

import argparse
import dataclasses
import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_cells import measure_cells
from coded_aperture_benchmarks.commands.bench_deblur_methods import (
    CODED,
    ESTIMATED,
    PRACTICE_SEED,
    TRUE,
    Practice,
    add_method_options,
    ahead,
    ahead_text,
    best_strengths,
    check_methods,
    deblur,
    own_methods,
    parameter_of,
)
from coded_aperture_benchmarks.commands.bench_deblur_pictures import as_rgb, enlarged, side_by_side
from coded_aperture_benchmarks.commands.bench_methods import BANK, Setting, identify
from coded_aperture_benchmarks.commands.bench_options import (
    add_masks_option,
    add_picture_options,
    add_result_options,
    check_result_options,
    report,
)
from coded_aperture_ros.cli.options import add_sigmas_option, at_least, folder_of, mask_of, table

_SIGMAS = (0.0, 0.001, 0.002, 0.005)
# The depth that is estimated is that of the benchmark of blur identification.
_WINDOW_PX = 96
_RANK = 400
# Of the stair that reference methods find their strength on: it covers all blur sizes.
_PRACTICE_LEVELS = 10
# A picture without any texture, which the error of everything else has to be seen beside.
_GREY = "grey"
# The steps that are drawn, as shares of the way up the stair.
_SHOWN_STEPS = (0.1, 0.5, 0.9)
_ENLARGED = 2
_EPILOG = """examples:
  two masks, four noise levels, all methods, next to the numbers of the thesis:
    coded_aperture bench deblur stair
  one mask and noise, both textures of the thesis, with pictures:
    coded_aperture bench deblur stair --masks levin --sigmas 0.001 --textures natural random \\
        --output results/
  a stair of 9 small steps, closed form against the sparse prior of Levin et al.:
    coded_aperture bench deblur stair --levels 9 --side 64 --window 48 --methods fast levin
"""


# A method and the depth that it was given; the frame itself has none.
Key = tuple[str, str | None]


@dataclasses.dataclass(frozen=True)
class Cell:
    """One number of each method's table: a texture, a mask and a noise."""

    texture: str
    mask: str
    sigma: float
    methods: tuple[str, ...]
    images: Path | None
    seeds: tuple[int, ...]
    levels: int
    side_px: int
    window_px: int
    rank: int
    known_noise: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """What was measured for a cell.

    Attributes
    ----------
    rows : list of dict
        The numbers of each method and depth, for JSON.
    steps : dict
        Of the first repeat: for each method and depth (the coded and the true picture have none)
        the steps that are drawn, [steps, side, side].
    """

    rows: list[dict[str, Any]]
    steps: dict[Key, Any]


def add_parser(subparsers: Any) -> None:
    """Add these frames to the parser of `bench deblur`."""
    parser = subparsers.add_parser(
        "stair",
        help="a stair of blur sizes, as in the thesis",
        description="Error sqrt(|f - f*|^2 + |grad f - grad f*|^2), root mean square, of the sharp "
        "picture that is made of a column of crops, each blurred with the next of 39 sizes from 7 "
        "to 30 px (M. Martinello, Coded Aperture Imaging, PhD thesis, 2012, tables 6.5 to 6.8), by "
        "the true blur and by the blur that a filter bank estimates.",
        epilog=_EPILOG,
    )
    parser.add_argument(
        "--textures",
        nargs="+",
        choices=("natural", "random", "soft"),
        default=["natural"],
        metavar="TEXTURE",
        help="natural (unselected crops of photographs), soft (the same at half size) or random "
        "(white noise) (default natural)",
    )
    add_masks_option(parser, ("four_hole", "levin"))
    add_sigmas_option(parser, _SIGMAS)
    add_method_options(parser)
    parser.add_argument(
        "--repeats",
        type=at_least(1),
        default=1,
        metavar="N",
        help="stairs with other crops and noise to take the mean over (default 1)",
    )
    parser.add_argument(
        "--levels",
        type=at_least(2),
        default=39,
        metavar="N",
        help="blur sizes, equally spaced from 7 to 30 px (default 39)",
    )
    parser.add_argument(
        "--side", type=at_least(16), default=125, metavar="PX", help="of a step (default 125)"
    )
    parser.add_argument(
        "--window",
        type=at_least(16),
        default=_WINDOW_PX,
        metavar="PX",
        help=f"side of the patches that depth is estimated from (default {_WINDOW_PX})",
    )
    parser.add_argument(
        "--rank",
        type=at_least(1),
        default=_RANK,
        metavar="R",
        help=f"vectors in the bank's common basis (default {_RANK})",
    )
    add_picture_options(parser)
    add_result_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    from coded_aperture_ros.io.textures import load_textures

    methods = check_methods(args)
    if args.window % 2:
        args.usage_error(f"--window: expected an even number, got {args.window}")
    for mask in args.masks:
        mask_of(mask)
    check_result_options(args)
    for texture in args.textures:
        load_textures(texture, folder_of(args.images))
    start = time.perf_counter()
    measured = measure_cells(measure_cell, list(_cells(args, methods)), args.jobs)
    rows = [row for cell in measured for row in cell.rows]
    found = ahead(rows, ("texture", "mask", "sigma", "depth"), lambda row: row["error"])
    report(
        args,
        {
            "benchmark": "deblur stair",
            "textures": args.textures,
            "images": args.images,
            "levels": args.levels,
            "side_px": args.side,
            "window_px": args.window,
            "repeats": args.repeats,
            "seed": args.seed,
            "known_noise": args.known_noise,
            "seconds": round(time.perf_counter() - start, 1),
            "cells": rows,
            "references_ahead": found,
        },
        lambda: "\n\n".join([_tables(rows), *_comparison(methods, rows, found)]),
        lambda folder: _draw(measured, folder),
    )
    return 0


def _cells(args: argparse.Namespace, methods: tuple[str, ...]) -> Iterator[Cell]:
    # Masks vary slowest, so that a process learns few banks.
    seeds = tuple(range(args.seed, args.seed + args.repeats))
    for mask, sigma, texture in itertools.product(args.masks, args.sigmas, args.textures):
        yield Cell(
            *(texture, mask, sigma, methods, folder_of(args.images), seeds),
            *(args.levels, args.side, args.window, args.rank, args.known_noise),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _Repeat:
    """One stair, deblurred.

    Attributes
    ----------
    stair : Stair
    pictures : dict
        The picture [rows, columns] of every method and depth, and of the baselines.
    seconds : dict
        What each took; baselines took none.
    level_error : float
        Mean error of the estimated levels.
    """

    stair: Any
    pictures: dict[Key, Any]
    seconds: dict[Key, float]
    level_error: float


def measure_cell(cell: Cell) -> Measured:
    """Deblur the stairs of one cell with every method, by both depths."""
    import numpy as np

    from coded_aperture_benchmarks.restoration import deblurring_error

    practice = None if set(cell.methods) <= set(own_methods()) else _practice(cell)
    strengths = {
        method: best_strengths(method, practice, {"error": deblurring_error})["error"]
        for method in cell.methods
    }
    repeats = [_repeat(cell, seed, strengths) for seed in cell.seeds]
    rows = []
    for key in repeats[0].pictures:
        method, depth = key
        pairs = [(repeat.pictures[key], repeat.stair.sharp) for repeat in repeats]
        errors = [deblurring_error(*pair) for pair in pairs]
        rms = [np.sqrt(np.mean((image - truth) ** 2, dtype=np.float64)) for image, truth in pairs]
        levels = [repeat.level_error if depth == ESTIMATED else 0.0 for repeat in repeats]
        seconds = [repeat.seconds[key] for repeat in repeats if key in repeat.seconds]
        rows.append(
            {
                "texture": cell.texture,
                "mask": cell.mask,
                "sigma": cell.sigma,
                "noise": round(repeats[0].stair.noise, 6),
                "method": method,
                "depth": depth,
                "error": round(float(np.mean(errors)), 5),
                "rms": round(float(np.mean(rms)), 5),
                "thesis_error": _thesis_error(cell, method),
                "level_error": None if depth is None else round(float(np.mean(levels)), 3),
                "parameter": parameter_of(method),
                "strength": strengths.get(method),
                "seconds": round(float(np.mean(seconds)), 3) if seconds else None,
            }
        )
    first = repeats[0]
    shown = {key: picture for key, picture in first.pictures.items() if key[0] != _GREY}
    shown[TRUE, None] = first.stair.sharp
    return Measured(rows, {key: _shown_steps(each, cell.levels) for key, each in shown.items()})


def _repeat(cell: Cell, seed: int, strengths: dict[str, float | None]) -> _Repeat:
    import numpy as np

    from coded_aperture_benchmarks.stair import level_error, make_stair
    from coded_aperture_ros.io.textures import load_textures

    textures = load_textures(cell.texture, cell.images)
    stair = make_stair(mask_of(cell.mask), textures, cell.sigma, seed, cell.levels, cell.side_px)
    told = stair.noise if cell.known_noise else None
    estimated = _estimated_level(cell, stair.coded, stair.noise, told)
    pictures: dict[Key, Any] = {
        (CODED, None): stair.coded,
        (_GREY, None): np.full_like(stair.sharp, stair.sharp.mean()),
    }
    seconds = {}
    for method, (depth, level) in itertools.product(
        cell.methods, ((TRUE, stair.level), (ESTIMATED, estimated))
    ):
        blur = np.interp(level, np.arange(cell.levels), stair.stack.blur_sizes_px)
        done = deblur(
            method, stair.coded, blur, stair.stack, strengths[method], told, depth == TRUE
        )
        pictures[method, depth], seconds[method, depth] = done.sharp, done.seconds
    mistaken = level_error(np.rint(estimated), stair.level, cell.levels)
    return _Repeat(stair, pictures, seconds, mistaken.mean)


def _practice(cell: Cell) -> Practice:
    """Return a stair of pictures that are not scored, of the same mask and noise."""
    from coded_aperture_benchmarks.stair import make_stair
    from coded_aperture_ros.io.textures import load_textures, training_textures

    textures = load_textures("random") if cell.texture == "random" else training_textures()
    levels = min(cell.levels, _PRACTICE_LEVELS)
    stair = make_stair(
        mask_of(cell.mask), textures, cell.sigma, PRACTICE_SEED, levels, cell.side_px
    )
    return Practice(stair.coded, stair.sharp, stair.level.astype(int), stair.stack)


def _estimated_level(cell: Cell, coded: Any, noise: float, told: float | None) -> Any:
    """Return the level that the filter bank finds, regularised as by default; none is missing."""
    from coded_aperture_benchmarks.stair import with_middle
    from coded_aperture_ros.depth import DepthConfig

    how = DepthConfig().regularize
    method = BANK if how == "none" else f"{BANK}-{how}"
    setting = Setting(cell.mask, cell.sigma, told, cell.levels, cell.window_px, cell.rank, None)
    return with_middle(identify(method, coded, noise, setting).level, cell.levels)


def _shown_steps(picture: Any, levels: int) -> Any:
    import numpy as np

    steps = picture.reshape(levels, -1, picture.shape[1])
    return steps[np.unique([round(share * (levels - 1)) for share in _SHOWN_STEPS])]


def _thesis_error(cell: Cell, method: str) -> float | None:
    """Return what the thesis reports for a cell; None if it has none or the stair is another."""
    from coded_aperture_benchmarks.stair import LEVELS, SIDE_PX
    from coded_aperture_benchmarks.thesis_tables import thesis_deblurring_error

    beside = _thesis_method(method)
    if (cell.levels, cell.side_px) != (LEVELS, SIDE_PX) or beside is None:
        return None
    return thesis_deblurring_error(cell.texture, cell.sigma, beside, cell.mask)


def _thesis_method(method: str) -> str | None:
    """Return the row of the thesis' tables that stands next to a method's numbers."""
    from coded_aperture_benchmarks.thesis_tables import OUR_METHOD

    if method in own_methods():
        return OUR_METHOD
    return _IN_THESIS.get(method, (None, ""))[0]


# The thesis' name of a reference method, in its tables as we have them and in words.
_IN_THESIS = {
    "richardson_lucy": ("lucy_richardson", "Lucy-Richardson"),
    "wiener": ("wiener", "Wiener filtering"),
    "levin": ("levin", "Levin et al."),
}


def _tables(rows: Sequence[dict[str, Any]]) -> str:
    """Return a table for every texture and method, masks down and noise across."""
    parts = [
        "error of deblurring by the true / by the estimated blur [thesis, same cell, by the blur "
        "that each of its\nmethods identified; ~ similar mask]; coded and grey: of the frame "
        "itself, and of a picture without texture"
    ]
    sigmas = sorted({row["sigma"] for row in rows})
    for texture, method in dict.fromkeys((row["texture"], row["method"]) for row in rows):
        here = [row for row in rows if (row["texture"], row["method"]) == (texture, method)]
        lines = []
        for mask in dict.fromkeys(row["mask"] for row in here):
            cells = [
                [row for row in here if (row["mask"], row["sigma"]) == (mask, sigma)]
                for sigma in sigmas
            ]
            times = [row["seconds"] for cell in cells for row in cell if row["seconds"] is not None]
            taken = f"{sum(times) / len(times):.1f} s" if times else "-"
            lines.append([_mask_text(mask), *map(_cell_text, cells), taken])
        header = ["mask", *(f"sigma {sigma:g}" for sigma in sigmas), "time"]
        parts.append(f"{texture} texture, {_method_text(method)}\n{table(header, lines)}")
    return "\n\n".join(parts)


def _mask_text(mask: str) -> str:
    from coded_aperture_ros.mask_design.subspaces import LETTER_OF_MASK, SAME_PATTERN

    if mask not in LETTER_OF_MASK:
        return mask
    return f"{mask} ({'' if mask in SAME_PATTERN else '~'}{LETTER_OF_MASK[mask]})"


def _method_text(method: str) -> str:
    if method in (CODED, _GREY):
        return method
    return f"{method} [thesis: {_IN_THESIS.get(method, ('', 'its own method'))[1]}]"


def _cell_text(rows: Sequence[dict[str, Any]]) -> str:
    errors = " / ".join(f"{row['error']:.3f}" for row in rows)
    thesis = rows[0]["thesis_error"]
    if rows[0]["depth"] is None:
        return errors
    return f"{errors} [{'-' if thesis is None else f'{thesis:.2f}'}]"


def _comparison(
    methods: Sequence[str], rows: Sequence[dict[str, Any]], found: Sequence[dict[str, Any]]
) -> list[str]:
    own = [method in own_methods() for method in methods]
    cells = sum(row["method"] == methods[0] for row in rows)
    return [ahead_text(found, cells)] if any(own) and not all(own) else []


def _draw(measured: Sequence[Measured], folder: Path) -> None:
    """Write a picture for every cell and depth: steps of three blur sizes, method by method."""
    from coded_aperture_ros.io import write_image

    for cell in measured:
        first = cell.rows[0]
        errors = {(row["method"], row["depth"]): row["error"] for row in cell.rows}
        for depth in (TRUE, ESTIMATED):
            columns: list[tuple[str, Key]] = [("coded", (CODED, None)), ("truth", (TRUE, None))]
            columns += [(method, (method, by)) for method, by in cell.steps if by == depth]
            name = Path(first["mask"]).stem
            write_image(
                folder / f"stair_{first['texture']}_{name}_{first['sigma']:g}_{depth}.png",
                side_by_side(
                    [
                        (
                            f"{title} {errors[key]:.3f}" if key in errors else title,
                            [enlarged(as_rgb(step), _ENLARGED) for step in cell.steps[key]],
                        )
                        for title, key in columns
                    ]
                ),
            )
