"""`coded_aperture bench accuracy two-plane`: blur identification at an occluding edge."""

import argparse
import dataclasses
import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_cells import measure_cells
from coded_aperture_benchmarks.commands.bench_methods import PLAIN, Setting, identify
from coded_aperture_benchmarks.commands.bench_options import (
    add_cell_options,
    check_cell_options,
    report,
)
from coded_aperture_ros.cli.options import at_least, folder_of, mask_of, table

_SIGMAS = (0.001,)
_METHODS = ("bank", "bank-semiglobal", "bank-tv", "bank-graphcut")
_WINDOW_PX, _RANK = 48, 128  # as the command learn
_REPEATS = 4
_EPILOG = """examples:
  two pairs of planes, with and without regularisation, next to a plain window of 48 px:
    coded_aperture bench accuracy two-plane
  planes with a blur of 8 and 12 px, figures of the error across the edge:
    coded_aperture bench accuracy two-plane --blurs 8,12 --methods bank-graphcut --output results/
"""


@dataclasses.dataclass(frozen=True)
class Cell:
    """One row of the table, and what it takes to measure it."""

    method: str
    blurs_px: tuple[float, float]
    setting: Setting
    texture: str
    images: Path | None
    seeds: tuple[int, ...]
    shape: tuple[int, int]
    known_noise: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """What was measured for a cell.

    Attributes
    ----------
    row : dict
        The numbers, for JSON.
    across : ndarray of float64
        Mean level of every column, over all repeats, for a figure.
    truth : ndarray of float32
        True level of every column.
    """

    row: dict[str, Any]
    across: Any
    truth: Any


def add_parser(subparsers: Any) -> None:
    """Add these frames to the parser of `bench accuracy`."""
    parser = subparsers.add_parser(
        "two-plane",
        help="two planes, one before the other",
        description="Mean error, in levels, of the blur that is identified on two textured "
        "planes with a straight edge between, rendered with exact occlusion: over all pixels, "
        "within 16 px of the edge, and beyond. The truth is what a pinhole sees. A bank with a "
        "plain window of 48 px is always measured, for comparison.",
        epilog=_EPILOG,
    )
    parser.add_argument(
        "--blurs",
        nargs="+",
        type=_pair,
        default=[(10.0, 14.0), (10.0, 22.0)],
        metavar="FRONT,BACK",
        help="blur sizes of the two planes in px (default 10,14 10,22)",
    )
    parser.add_argument(
        "--texture",
        choices=("natural", "random", "soft"),
        default="natural",
        help="unselected crops of photographs, the same at half size, or white noise "
        "(default natural)",
    )
    parser.add_argument(
        "--size",
        nargs=2,
        type=at_least(64),
        default=[320, 480],
        metavar=("ROWS", "COLUMNS"),
        help="of a frame (default 320 480)",
    )
    add_cell_options(parser, _SIGMAS, _REPEATS, _METHODS, _WINDOW_PX, _RANK)


def _pair(text: str) -> tuple[float, float]:
    front, back = (float(part) for part in text.split(","))
    return front, back


_pair.__name__ = "pair of sizes"  # argparse says "invalid pair of sizes value"


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    from coded_aperture_ros.io.textures import load_textures

    check_cell_options(args)
    load_textures(args.texture, folder_of(args.images))
    start = time.perf_counter()
    measured = measure_cells(measure_cell, list(_cells(args)), args.jobs)
    rows = [cell.row for cell in measured]
    compare_with_plain(rows)
    report(
        args,
        {
            "benchmark": "two-plane",
            "texture": args.texture,
            "images": args.images,
            "rows": args.size[0],
            "columns": args.size[1],
            "levels": args.levels,
            "window_px": args.window,
            "repeats": args.repeats,
            "seed": args.seed,
            "known_noise": args.known_noise,
            "seconds": round(time.perf_counter() - start, 1),
            "cells": rows,
        },
        lambda: _table(rows),
        lambda folder: _draw(measured, folder),
    )
    return 0


def _cells(args: argparse.Namespace) -> Iterator[Cell]:
    methods = list(dict.fromkeys([PLAIN, *args.methods]))
    for mask, sigma, blurs_px, method in itertools.product(
        args.masks, args.sigmas, args.blurs, methods
    ):
        yield Cell(
            method=method,
            blurs_px=blurs_px,
            setting=Setting(mask, sigma, None, args.levels, args.window, args.rank, args.stride),
            texture=args.texture,
            images=folder_of(args.images),
            seeds=tuple(range(args.seed, args.seed + args.repeats)),
            shape=(args.size[0], args.size[1]),
            known_noise=args.known_noise,
        )


def measure_cell(cell: Cell) -> Measured:
    """Measure one cell, all its repeats."""
    import numpy as np

    from coded_aperture_benchmarks.stair import with_middle
    from coded_aperture_benchmarks.two_plane import make_two_planes, two_plane_error
    from coded_aperture_ros.io.textures import load_textures

    setting = cell.setting
    mask = mask_of(setting.mask)
    textures = load_textures(cell.texture, cell.images)
    errors, profiles, seconds = [], [], []
    for seed in cell.seeds:
        truth = make_two_planes(
            mask, textures, *cell.blurs_px, setting.sigma, seed, setting.levels, cell.shape
        )
        told = dataclasses.replace(setting, noise=truth.noise if cell.known_noise else None)
        found = identify(cell.method, truth.coded, truth.noise, told)
        errors.append(dataclasses.astuple(two_plane_error(found.level, truth)))
        profiles.append(with_middle(found.level, setting.levels).mean(axis=0))
        seconds.append(found.seconds)
    everywhere, near_edge, beyond = np.mean(errors, axis=0)
    row = {
        "mask": setting.mask,
        "front_blur_px": cell.blurs_px[0],
        "back_blur_px": cell.blurs_px[1],
        "sigma": setting.sigma,
        "noise": round(truth.noise, 6),
        "method": cell.method,
        "mean_error": round(float(everywhere), 3),
        "mean_error_near_edge": round(float(near_edge), 3),
        "mean_error_beyond": round(float(beyond), 3),
        "seconds": round(float(np.mean(seconds)), 3),
    }
    return Measured(row, np.mean(profiles, axis=0), truth.level[0])


def compare_with_plain(rows: Sequence[dict[str, Any]]) -> None:
    """Add to every row its error near the edge over that of the plain window."""

    def place(row: dict[str, Any]) -> tuple[Any, ...]:
        return row["mask"], row["front_blur_px"], row["back_blur_px"], row["sigma"]

    plain = {place(row): row["mean_error_near_edge"] for row in rows if row["method"] == PLAIN}
    for row in rows:
        of_plain = plain[place(row)]
        ratio = row["mean_error_near_edge"] / of_plain if of_plain else float("nan")
        row["near_edge_over_plain"] = round(ratio, 3)


def _table(rows: Sequence[dict[str, Any]]) -> str:
    header = [
        *("mask", "blurs px", "sigma", "method", "all pixels", "within 16 px", "beyond"),
        *(f"within / {PLAIN}", "time"),
    ]
    lines = [
        [
            row["mask"],
            f"{row['front_blur_px']:g}, {row['back_blur_px']:g}",
            f"{row['sigma']:g}",
            row["method"],
            f"{row['mean_error']:.2f}",
            f"{row['mean_error_near_edge']:.2f}",
            f"{row['mean_error_beyond']:.2f}",
            f"{row['near_edge_over_plain']:.2f}",
            f"{row['seconds']:.1f} s",
        ]
        for row in rows
    ]
    return f"mean error in levels\n{table(header, lines)}"


def _draw(measured: Sequence[Measured], folder: Path) -> None:
    from coded_aperture_benchmarks import plots

    panels: dict[str, dict[str, Any]] = {}
    truths = {}
    for cell in measured:
        row = cell.row
        title = (
            f"{row['mask']}, {row['front_blur_px']:g} and {row['back_blur_px']:g} px, "
            f"sigma {row['sigma']:g}"
        )
        panels.setdefault(title, {})[row["method"]] = cell.across
        truths[title] = cell.truth
    plots.edge_profiles(panels, truths, folder / "edges.png")
