"""`coded_aperture bench accuracy simple`: masks of a few equal holes, thesis table 5.1."""

import argparse
import dataclasses
import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_cells import measure_cells
from coded_aperture_benchmarks.commands.bench_methods import (
    BANK,
    CONDITIONAL,
    SIMPLE,
    Setting,
    identify,
    method_names,
    reference_methods,
    simple_methods,
)
from coded_aperture_benchmarks.commands.bench_options import (
    add_cases_option,
    add_masks_option,
    add_picture_options,
    add_result_options,
    check_result_options,
    report,
)
from coded_aperture_ros.cli.options import add_numbers, folder_of, mask_of, table

_MASKS = ("two_hole", "three_hole", "four_hole")
_CASES = (("random", 0.0001), ("natural", 0.001))
_WINDOW_PX, _RANK = 96, 400
_SIDE_PX = 160
_TEXTURES = ("natural", "random", "soft")
_REFERENCES = "references"
_METHODS = (SIMPLE, CONDITIONAL, BANK, _REFERENCES)
_EPILOG = """examples:
  table 5.1 of the thesis, and natural texture; the reference methods take most of the time:
    coded_aperture bench accuracy simple
  without them, with the windows that fit depth edges:
    coded_aperture bench accuracy simple --methods simple bank --window 48
  at other noises, regularised:
    coded_aperture bench accuracy simple --cases natural,0.0001 natural,0.005 \\
        --methods simple-graphcut bank-graphcut
"""


@dataclasses.dataclass(frozen=True)
class Cell:
    """One number of the table, and what it takes to measure it."""

    method: str
    texture: str
    setting: Setting
    images: Path | None
    seeds: tuple[int, ...]
    side_px: int
    known_noise: bool


def add_parser(subparsers: Any) -> None:
    """Add these frames to the parser of `bench accuracy`."""
    parser = subparsers.add_parser(
        "simple",
        help="planes behind masks of a few equal holes",
        description="Mean error, in levels, of the blur that is identified on textured planes, one "
        "in every frame, at 33 blur sizes from 7 to 30 px (M. Martinello, Coded Aperture Imaging, "
        "PhD thesis, 2012, table 5.1), by the method for simple masks, its data term as the thesis "
        "has it, the filter bank with a window of the same size, and reference methods.",
        epilog=_EPILOG,
    )
    add_masks_option(parser, _MASKS)
    add_cases_option(parser, _TEXTURES, _CASES, "open fraction of the mask's square")
    parser.add_argument(
        "--methods",
        nargs="+",
        default=list(_METHODS),
        metavar="METHOD",
        help="simple, simple-tv and so on, conditional (the thesis' data term), bank and others as "
        f"of the frames stair, or {_REFERENCES}: all reference methods "
        f"(default {' '.join(_METHODS)})",
    )
    add_numbers(
        parser,
        ("levels", 2, 33, "blur sizes, equally spaced from 7 to 30 px"),
        ("window", 16, _WINDOW_PX, "side of the windows, a multiple of 8, px"),
        ("rank", 1, _RANK, "vectors in the bank's common basis"),
        ("side", 64, _SIDE_PX, "side of a plane, px; its inner quarter is scored"),
        ("repeats", 1, 1, "planes of every level, with other crops and noise"),
        ("seed", 0, 0, "of the first repeat"),
    )
    add_picture_options(parser)
    add_result_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    from coded_aperture_ros.io.textures import load_textures
    from coded_aperture_ros.methods.two_pixel import find_holes

    methods = _methods(args)
    if args.window % 8:
        args.usage_error(f"--window: expected a multiple of 8, got {args.window}")
    if args.side < args.window:
        args.usage_error(f"--side: {args.side} px are less than the window of {args.window} px")
    for mask in args.masks:
        found = mask_of(mask)
        if {*simple_methods(), CONDITIONAL} & set(methods):
            find_holes(found)
    for texture, _ in args.cases:
        load_textures(texture, folder_of(args.images))
    check_result_options(args)
    start = time.perf_counter()
    rows = measure_cells(measure_cell, list(_cells(args, methods)), args.jobs)
    compare(rows)
    report(
        args,
        {
            "benchmark": "simple",
            "images": args.images,
            "levels": args.levels,
            "side_px": args.side,
            "window_px": args.window,
            "repeats": args.repeats,
            "seed": args.seed,
            "known_noise": args.known_noise,
            "seconds": round(time.perf_counter() - start, 1),
            "cells": rows,
        },
        lambda: _table(rows),
    )
    return 0


def _methods(args: argparse.Namespace) -> list[str]:
    methods: list[str] = []
    for method in args.methods:
        methods += reference_methods() if method == _REFERENCES else [method]
    for method in methods:
        if method not in method_names():
            args.usage_error(
                f"--methods: unknown method {method!r}, use some of "
                f"{', '.join((*method_names(), _REFERENCES))}"
            )
    return list(dict.fromkeys(methods))


def _cells(args: argparse.Namespace, methods: Sequence[str]) -> Iterator[Cell]:
    # Masks vary slowest, so that a process learns few banks.
    for mask, (texture, sigma), method in itertools.product(args.masks, args.cases, methods):
        yield Cell(
            method=method,
            texture=texture,
            setting=Setting(mask, sigma, None, args.levels, args.window, args.rank, None),
            images=folder_of(args.images),
            seeds=tuple(range(args.seed, args.seed + args.repeats)),
            side_px=args.side,
            known_noise=args.known_noise,
        )


def measure_cell(cell: Cell) -> dict[str, Any]:
    """Measure one method on all planes of one mask, texture and noise."""
    import numpy as np

    from coded_aperture_benchmarks.single_planes import make_planes
    from coded_aperture_benchmarks.stair import level_error
    from coded_aperture_ros.io.textures import load_textures

    setting = cell.setting
    textures = load_textures(cell.texture, cell.images)
    margin = cell.side_px // 4
    inner = (slice(margin, cell.side_px - margin),) * 2
    errors, seconds = [], []
    for seed in cell.seeds:
        planes = make_planes(
            mask_of(setting.mask), textures, setting.sigma, seed, setting.levels, cell.side_px
        )
        told = dataclasses.replace(setting, noise=planes.noise if cell.known_noise else None)
        for level, coded in enumerate(planes.coded):
            found = identify(cell.method, coded, planes.noise, told)
            # The planes are at levels: whole numbers, as all estimates of the thesis are.
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
        "mean_error": round(float(np.mean([error.mean for error in errors])), 3),
        "known": round(float(np.mean([error.known for error in errors])), 4),
        "thesis_mean_error": _thesis_error(cell),
        # The first frame of a size pays for the plan; a sum of many shows neither it nor a pause.
        "seconds_per_plane": round(float(np.median(seconds)), 4),
    }


def _thesis_error(cell: Cell) -> float | None:
    """Return what table 5.1 has for a cell; None if it has none."""
    from coded_aperture_benchmarks.single_planes import LEVELS, SIGMA, TABLE_5_1

    setting = cell.setting
    if (cell.texture, setting.sigma, setting.levels) != ("random", SIGMA, LEVELS):
        return None
    method = SIMPLE if cell.method in simple_methods() else cell.method
    return TABLE_5_1.get(method, {}).get(setting.mask)


def compare(rows: Sequence[dict[str, Any]]) -> None:
    """Add to every row its error over that of the bank, where that was measured."""

    def place(row: dict[str, Any]) -> tuple[Any, ...]:
        return row["mask"], row["texture"], row["sigma"]

    bank = {place(row): row["mean_error"] for row in rows if row["method"] == BANK}
    for row in rows:
        of_bank = bank.get(place(row))
        row["over_bank"] = round(row["mean_error"] / of_bank, 3) if of_bank else None


def _table(rows: Sequence[dict[str, Any]]) -> str:
    """Return a table for every texture and noise, methods down and masks across."""
    parts = ["mean error in levels / over the bank's [thesis, table 5.1]"]
    masks = list(dict.fromkeys(row["mask"] for row in rows))
    for texture, sigma in dict.fromkeys((row["texture"], row["sigma"]) for row in rows):
        here = [row for row in rows if (row["texture"], row["sigma"]) == (texture, sigma)]
        lines = []
        for method in dict.fromkeys(row["method"] for row in here):
            cells = {row["mask"]: row for row in here if row["method"] == method}
            seconds = sum(row["seconds_per_plane"] for row in cells.values()) / len(cells)
            lines.append(
                [method, *(_text(cells[mask]) for mask in masks), f"{1000 * seconds:.0f} ms"]
            )
        header = ["method", *masks, "a plane"]
        parts.append(f"{texture} texture, sigma {sigma:g}\n{table(header, lines)}")
    return "\n\n".join(parts)


def _text(row: dict[str, Any]) -> str:
    text = f"{row['mean_error']:.2f}"
    if row["over_bank"] is not None:
        text += f" / {row['over_bank']:.2f}"
    thesis = row["thesis_mean_error"]
    return text if thesis is None else f"{text} [{thesis:.1f}]"
