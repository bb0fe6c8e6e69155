"""`coded_aperture bench accuracy stair`: the stair of blur sizes of thesis 6.3.1."""

import argparse
import dataclasses
import itertools
import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_cells import measure_cells
from coded_aperture_benchmarks.commands.bench_methods import (
    PLAIN,
    SUBSPACE,
    Setting,
    identify,
    is_bank,
)
from coded_aperture_benchmarks.commands.bench_options import (
    add_cell_options,
    check_cell_options,
    report,
)
from coded_aperture_ros.cli.options import at_least, folder_of, mask_of, table

_SIGMAS = (0.0, 0.001, 0.002, 0.005)
_METHODS = ("bank", "bank-semiglobal", "bank-graphcut")
# The steps are wide and flat: the largest window that fits well into one of them.
_WINDOW_PX = 96
_RANK = 400
_REPEATS = 2
# Of the maps that are drawn: a figure has fewer pixels than a stair.
_MAP_STEP = 5
_EPILOG = """examples:
  two masks, four noise levels, with and without graph cuts, next to the numbers of the thesis:
    coded_aperture bench accuracy stair
  one mask against the reference methods, with figures:
    coded_aperture bench accuracy stair --masks levin --sigmas 0 0.001 \\
        --methods bank wiener levin --output results/
  photographs of your own at half size, a stair of 9 small steps:
    coded_aperture bench accuracy stair --images photographs/ --textures soft --levels 9 \\
        --side 64 --window 48
"""


@dataclasses.dataclass(frozen=True)
class Cell:
    """One number of each texture's table, and what it takes to measure them.

    All textures at once: a reference method that learns weights does so once for them.
    """

    textures: tuple[str, ...]
    method: str
    setting: Setting
    images: Path | None
    seeds: tuple[int, ...]
    side_px: int
    known_noise: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """What was measured for a cell.

    Attributes
    ----------
    row : dict
        The numbers, for JSON.
    level_map : ndarray of float32
        Estimated levels of the first repeat, thinned out, for a figure.
    reliability : Reliability or None
        Of all repeats.
    """

    row: dict[str, Any]
    level_map: Any
    reliability: Any


def add_parser(subparsers: Any) -> None:
    """Add these frames to the parser of `bench accuracy`."""
    parser = subparsers.add_parser(
        "stair",
        help="a stair of blur sizes, as in the thesis",
        description="Mean error, in levels, of the blur that is identified on a column of crops, "
        "each blurred with the next of 39 sizes from 7 to 30 px (M. Martinello, Coded Aperture "
        "Imaging, PhD thesis, 2012, section 6.3.1). All pixels count, those at the boundaries of "
        "steps too.",
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
    parser.add_argument(
        "--side", type=at_least(16), default=125, metavar="PX", help="of a step (default 125)"
    )
    add_cell_options(parser, _SIGMAS, _REPEATS, _METHODS, _WINDOW_PX, _RANK)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    from coded_aperture_ros.io.textures import load_textures

    check_cell_options(args)
    for texture in args.textures:
        load_textures(texture, folder_of(args.images))
    start = time.perf_counter()
    parts = measure_cells(measure_cell, list(_cells(args)), args.jobs)
    measured = [part for of_cell in parts for part in of_cell]
    rows = [part.row for part in measured]
    worse = lost_cells(rows)
    report(
        args,
        {
            "benchmark": "stair",
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
            "bank_is_beaten": worse,
            "reliability": [
                {"texture": texture, "method": method, **_summary(total)}
                for texture, method, total in _reliabilities(measured)
            ],
        },
        lambda: "\n\n".join([_tables(rows), *_comparison(rows, worse)]),
        lambda folder: _draw(args, measured, folder),
    )
    return 0


def _cells(args: argparse.Namespace) -> Iterator[Cell]:
    # Masks vary slowest, so that a process learns few banks.
    textures = tuple(args.textures)
    for mask, sigma, method in itertools.product(args.masks, args.sigmas, args.methods):
        setting = Setting(mask, sigma, None, args.levels, args.window, args.rank, args.stride)
        seeds = tuple(range(args.seed, args.seed + args.repeats))
        images = folder_of(args.images)
        yield Cell(textures, method, setting, images, seeds, args.side, args.known_noise)


def measure_cell(cell: Cell) -> list[Measured]:
    """Measure one cell of every texture, all its repeats."""
    return [_measure(cell, texture) for texture in cell.textures]


def _measure(cell: Cell, texture: str) -> Measured:
    import numpy as np

    from coded_aperture_benchmarks.stair import level_error, make_stair, spread_per_step
    from coded_aperture_ros.io.textures import load_textures
    from coded_aperture_ros.metrics.reliability import Reliability

    setting = cell.setting
    mask = mask_of(setting.mask)
    textures = load_textures(texture, cell.images)
    errors, spreads, estimates, reliabilities = [], [], [], []
    for seed in cell.seeds:
        stair = make_stair(mask, textures, setting.sigma, seed, setting.levels, cell.side_px)
        told = dataclasses.replace(setting, noise=stair.noise if cell.known_noise else None)
        found = identify(cell.method, stair.coded, stair.noise, told)
        # The steps are levels of the bank: whole numbers, as all estimates of the thesis are.
        found = dataclasses.replace(found, level=np.rint(found.level))
        errors.append(level_error(found.level, stair.level, setting.levels, found.confidence))
        spreads.append(spread_per_step(found.level, setting.levels))
        estimates.append(found)
        if found.confidence is not None:
            known = np.isfinite(found.level)
            right = np.abs(found.level[known] - stair.level[known]) <= 1
            reliabilities.append(Reliability.of(found.confidence[known], right))
    means, deviations = (np.array(part) for part in zip(*spreads, strict=True))
    mean = means.mean(axis=0)
    deviation = np.sqrt((deviations**2 + (means - mean) ** 2).mean(axis=0))
    noises = [found.noise for found in estimates if found.noise is not None]
    row = {
        "mask": setting.mask,
        "texture": texture,
        "sigma": setting.sigma,
        "noise": round(stair.noise, 6),
        "method": cell.method,
        "mean_error": round(float(np.mean([error.mean for error in errors])), 3),
        "mean_error_confident_half": round(
            float(np.mean([error.mean_confident for error in errors])), 3
        ),
        "known": round(float(np.mean([error.known for error in errors])), 4),
        "thesis_mean_error": _thesis_error(cell, texture),
        "noise_estimated": round(float(np.mean(noises)), 6) if noises else None,
        "seconds": round(float(np.mean([found.seconds for found in estimates])), 3),
        "mean_of_step": [round(float(value), 3) for value in mean],
        "deviation_of_step": [round(float(value), 3) for value in deviation],
    }
    level_map = estimates[0].level[::_MAP_STEP, ::_MAP_STEP].astype(np.float32)
    return Measured(row, level_map, Reliability.total(reliabilities) if reliabilities else None)


def _thesis_error(cell: Cell, texture: str) -> float | None:
    """Return what the thesis reports for a cell; None if it has none or the stair is another."""
    from coded_aperture_benchmarks.stair import LEVELS, SIDE_PX
    from coded_aperture_benchmarks.thesis_tables import thesis_error

    setting = cell.setting
    if (setting.levels, cell.side_px) != (LEVELS, SIDE_PX):
        return None
    return thesis_error(texture, setting.sigma, _thesis_method(cell.method), setting.mask)


def _thesis_method(method: str) -> str:
    """Return the row of the thesis' tables that stands next to a method's numbers."""
    from coded_aperture_benchmarks.thesis_tables import OUR_METHOD

    return OUR_METHOD if is_bank(method) or method in (PLAIN, SUBSPACE) else method


def lost_cells(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return where a method that is not the bank has a smaller error than the bank.

    Every variant of the bank that was measured is compared.
    """

    def place(row: dict[str, Any]) -> tuple[Any, ...]:
        return row["mask"], row["texture"], row["sigma"]

    banks = [row for row in rows if is_bank(row["method"])]
    others = [row for row in rows if not is_bank(row["method"]) and row["method"] != PLAIN]
    return [
        {
            "mask": bank["mask"],
            "texture": bank["texture"],
            "sigma": bank["sigma"],
            "method": other["method"],
            "mean_error": other["mean_error"],
            "bank": bank["method"],
            "bank_mean_error": bank["mean_error"],
        }
        for bank in banks
        for other in others
        if place(other) == place(bank) and other["mean_error"] < bank["mean_error"]
    ]


def _comparison(rows: Sequence[dict[str, Any]], worse: Sequence[dict[str, Any]]) -> list[str]:
    methods = {row["method"] for row in rows} - {PLAIN}
    if not any(map(is_bank, methods)) or all(map(is_bank, methods)):
        return []
    if not worse:
        return ["no other method beats the bank in any cell"]
    lines = [
        f"{cell['method']} beats {cell['bank']}: {cell['mask']}, {cell['texture']}, "
        f"sigma {cell['sigma']:g}: {cell['mean_error']:.2f} against {cell['bank_mean_error']:.2f}"
        for cell in worse
    ]
    return ["\n".join(lines)]


def _tables(rows: Sequence[dict[str, Any]]) -> str:
    """Return a table for every texture and method, masks down and noise across."""
    from coded_aperture_ros.mask_design.subspaces import LETTER_OF_MASK, SAME_PATTERN

    parts = [
        "mean error in levels / over the most confident half of the pixels [thesis, same cell; "
        "~ similar mask]"
    ]
    sigmas = sorted({row["sigma"] for row in rows})
    for texture, method in dict.fromkeys((row["texture"], row["method"]) for row in rows):
        here = [row for row in rows if (row["texture"], row["method"]) == (texture, method)]
        lines = []
        for mask in dict.fromkeys(row["mask"] for row in here):
            cells = {row["sigma"]: row for row in here if row["mask"] == mask}
            similar = "" if mask in SAME_PATTERN else "~"
            seconds = sum(row["seconds"] for row in cells.values()) / len(cells)
            letter = f" ({similar}{LETTER_OF_MASK[mask]})" if mask in LETTER_OF_MASK else ""
            lines.append(
                [
                    mask + letter,
                    *(_cell_text(cells[sigma]) for sigma in sigmas),
                    f"{seconds:.1f} s",
                ]
            )
        beside = _thesis_method(method)
        title = f"{texture} texture, {method} [thesis: {_IN_THESIS.get(beside, 'not measured')}]"
        header = ["mask", *(f"sigma {sigma:g}" for sigma in sigmas), "time"]
        parts.append(f"{title}\n{table(header, lines)}")
    return "\n\n".join(parts)


_IN_THESIS = {
    "thesis": "its own method",
    "levin": "Levin et al.",
    "wiener": "Wiener filtering",
    "regularized": "regularised filtering",
    "lucy_richardson": "Lucy-Richardson",
}


def _cell_text(row: dict[str, Any]) -> str:
    text = f"{row['mean_error']:.2f}"
    confident = row["mean_error_confident_half"]
    if not math.isnan(confident):  # the method has a confidence
        text += f" / {confident:.2f}"
    thesis = row["thesis_mean_error"]
    return f"{text} [{'-' if thesis is None else f'{thesis:.1f}'}]"


def _reliabilities(measured: Sequence[Measured]) -> Iterator[tuple[str, str, Any]]:
    """Yield texture, method and the reliability over all masks and noise levels."""
    from coded_aperture_ros.metrics.reliability import Reliability

    groups: dict[tuple[str, str], list[Any]] = {}
    for cell in measured:
        if cell.reliability is not None:
            key = (cell.row["texture"], cell.row["method"])
            groups.setdefault(key, []).append(cell.reliability)
    for (texture, method), parts in groups.items():
        yield texture, method, Reliability.total(parts)


def _summary(reliability: Any) -> dict[str, Any]:
    error = reliability.expected_calibration_error
    return {"expected_calibration_error": round(error, 4), "bins": reliability.rows()}


def _draw(args: argparse.Namespace, measured: Sequence[Measured], folder: Path) -> None:
    from coded_aperture_benchmarks import plots
    from coded_aperture_ros.metrics.figures import reliability_diagram

    for texture in args.textures:
        cells = [cell for cell in measured if cell.row["texture"] == texture]
        plots.stair_spread([cell.row for cell in cells], folder / f"spread_{texture}.png")
        for sigma in args.sigmas:
            maps = {
                f"{cell.row['mask']}\n{cell.row['method']}": cell.level_map
                for cell in cells
                if cell.row["sigma"] == sigma
            }
            plots.stair_maps(maps, args.levels, folder / f"maps_{texture}_{sigma:g}.png")
    curves = {f"{texture}, {method}": total for texture, method, total in _reliabilities(measured)}
    if curves:
        reliability_diagram(
            curves, folder / "reliability.png", "right to one level (all masks and noises)"
        )
