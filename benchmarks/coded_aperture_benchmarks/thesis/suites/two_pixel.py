"""Masks of a few equal holes, thesis table 5.1."""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.methods import identification
from coded_aperture_benchmarks.rows import grouped, mean_of, place, tables, unique
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.thesis.planes import LEVELS, SIGMA, TABLE_5_1, make_planes
from coded_aperture_benchmarks.thesis.reference import REFERENCE_METHODS
from coded_aperture_benchmarks.thesis.stair import level_error
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.likelihood.two_pixel import find_holes
from coded_aperture_ros.optics import load_mask

_REFERENCES = "references"
_METHODS = (identification.TWO_PIXEL, identification.CONDITIONAL, identification.BANK, _REFERENCES)


@dataclasses.dataclass(frozen=True)
class Cell(identification.MethodOnFrames):
    """One number of the table."""

    texture: str
    side_px: int


def _cells(args: options.Args) -> list[Cell]:
    known = (*identification.method_names(), _REFERENCES)
    options.check_known(args, "methods", args.methods, known)
    methods = list(
        dict.fromkeys(
            itertools.chain(
                *(REFERENCE_METHODS if each == _REFERENCES else [each] for each in args.methods)
            )
        )
    )
    if args.window % 8:
        args.usage_error(f"--window: expected a multiple of 8, got {args.window}")
    if args.side < args.window:
        args.usage_error(f"--side: {args.side} px are less than the window of {args.window} px")
    options.check_masks(args)
    if any(
        identification.is_two_pixel(method) or method == identification.CONDITIONAL
        for method in methods
    ):
        for mask in args.masks:
            find_holes(load_mask(mask))
    options.check_textures(args, (texture for texture, _ in args.cases))
    return [
        Cell(
            method,
            identification.Setting(mask, sigma, None, args.levels, args.window, args.rank),
            options.images_of(args),
            options.seeds_of(args),
            args.known_noise,
            texture,
            args.side,
        )
        # Masks vary slowest, so that a process learns few banks.
        for mask, (texture, sigma), method in itertools.product(args.masks, args.cases, methods)
    ]


def measure(cell: Cell) -> Row:
    """Measure one method on all planes of one mask, texture and noise."""
    setting = cell.setting
    mask, textures = load_mask(setting.mask), load_textures(cell.texture, cell.images)
    margin = cell.side_px // 4
    inner = (slice(margin, cell.side_px - margin),) * 2
    errors, seconds = [], []
    for seed in cell.seeds:
        planes = make_planes(mask, textures, setting.sigma, seed, setting.levels, cell.side_px)
        for level, coded in enumerate(planes.coded):
            found = cell.identify(coded, planes.noise)
            # Whole numbers, as all estimates of the thesis are.
            estimated = np.rint(found.level[inner])
            truth = np.full_like(estimated, level)
            errors.append(level_error(estimated, truth, setting.levels))
            seconds.append(found.seconds)
    return {
        "mask": setting.mask,
        "texture": cell.texture,
        "sigma": setting.sigma,
        "noise": round(planes.noise, 6),
        "method": cell.method,
        "mean_error": mean_of((error.mean for error in errors), 3),
        "known": mean_of((error.known for error in errors), 4),
        "thesis_mean_error": _thesis_error(cell),
        # The first frame of a size pays for the plan; a sum of many shows neither it nor a pause.
        "seconds_per_plane": round(float(np.median(seconds)), 4),
    }


def _thesis_error(cell: Cell) -> float | None:
    """Return what table 5.1 has for a cell; None if it has none."""
    setting = cell.setting
    if (cell.texture, setting.sigma, setting.levels) != ("random", SIGMA, LEVELS):
        return None
    method = identification.TWO_PIXEL if identification.is_two_pixel(cell.method) else cell.method
    return TABLE_5_1.get(method, {}).get(setting.mask)


def _results(args: options.Args, rows: list[Row]) -> Row:
    return {"cells": compared_with_bank(rows)}


def compared_with_bank(rows: Sequence[Row]) -> list[Row]:
    """Return the rows with their error over that of the bank, where that was measured."""
    names = ("mask", "texture", "sigma")
    bank = {
        place(row, *names): row["mean_error"]
        for row in rows
        if row["method"] == identification.BANK
    }

    def ratio(row: Row) -> float | None:
        of_bank = bank.get(place(row, *names))
        return round(row["mean_error"] / of_bank, 3) if of_bank else None

    return [{**row, "over_bank": ratio(row)} for row in rows]


def _text(results: Row) -> str:
    return tables(
        "mean error in levels / over the bank's [thesis, table 5.1]",
        results["cells"],
        ("texture", "sigma"),
        "{texture} texture, sigma {sigma:g}",
        _table,
    )


def _table(rows: list[Row]) -> str:
    """Return methods down and masks across."""
    names = unique(rows, "mask")
    lines = []
    for (method,), cells in grouped(rows, "method").items():
        of_mask = {row["mask"]: row for row in cells}
        seconds = sum(row["seconds_per_plane"] for row in cells) / len(cells)
        texts = [_cell_text(of_mask[mask]) for mask in names]
        lines.append([method, *texts, f"{1000 * seconds:.0f} ms"])
    return table(["method", *names, "a plane"], lines)


def _cell_text(row: Row) -> str:
    text = f"{row['mean_error']:.2f}"
    if row["over_bank"] is not None:
        text += f" / {row['over_bank']:.2f}"
    thesis = row["thesis_mean_error"]
    return text if thesis is None else f"{text} [{thesis:.1f}]"


SUITE = Suite(
    name="two_pixel",
    said=("images", "levels", "side", "window", "repeats", "seed", "known_noise"),
    description="Mean error, in levels, of the blur that is identified on textured planes, one "
    "in every frame, at 33 blur sizes from 7 to 30 px (M. Martinello, Coded Aperture Imaging, "
    "PhD thesis, 2012, table 5.1), by the two-pixel method, its data term as the thesis "
    "has it, the filter bank with a window of the same size, and reference methods.",
    examples="""examples:
  table 5.1 of the thesis, and natural texture; the reference methods take most of the time:
    coded_aperture bench accuracy two_pixel
  without them, with the windows that fit depth edges:
    coded_aperture bench accuracy two_pixel --methods two_pixel bank --window 48
  at other noises, regularised:
    coded_aperture bench accuracy two_pixel --cases natural,0.0001 natural,0.005 \\
        --methods two_pixel-graphcut bank-graphcut
""",
    options=(
        options.masks("two_hole", "three_hole", "four_hole"),
        options.cases(
            (("random", 0.0001), ("natural", 0.001)), "open fraction of the mask's square"
        ),
        options.option(
            "--methods",
            "two_pixel, two_pixel-tv and so on, conditional (the thesis' data term), bank and "
            f"others as of the frames stair, or {_REFERENCES}: all reference methods",
            list(_METHODS),
            metavar="METHOD",
        ),
        options.blur_levels(33),
        options.number("--window", 16, 96, "side of the windows, a multiple of 8, px"),
        options.number("--rank", 1, 400, "vectors in the bank's common basis"),
        options.number("--side", 64, 160, "side of a plane, px; its inner quarter is scored"),
        options.number("--repeats", 1, 1, "planes of every level, with other crops and noise"),
        options.number("--seed", 0, 0, "of the first repeat"),
        *options.PICTURES,
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
