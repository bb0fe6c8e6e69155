"""The stair of blur sizes of thesis 6.3.1."""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.methods import identification
from coded_aperture_benchmarks.rows import grouped, mean_of, place, tables, unique
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.thesis import figures
from coded_aperture_benchmarks.thesis.stair import (
    LEVELS,
    SIDE_PX,
    level_error,
    make_stair,
    spread_per_step,
)
from coded_aperture_benchmarks.thesis.tables import (
    IN_WORDS,
    OUR_METHOD,
    mask_with_letter,
    thesis_error,
)
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.metrics.figures import reliability_diagram
from coded_aperture_ros.metrics.reliability import Reliability
from coded_aperture_ros.optics import load_mask

# The steps are wide and flat: the largest window that fits well into one of them.
_WINDOW_PX, _RANK = 96, 400
# Of the maps that are drawn: a figure has fewer pixels than a stair.
_MAP_STEP = 5


@dataclasses.dataclass(frozen=True)
class Cell(identification.MethodOnFrames):
    """One number of each texture's table.

    All textures at once: a reference method that learns weights does so once for them.
    """

    textures: tuple[str, ...]
    side_px: int


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of one texture, its first map, thinned out, and the reliability of all."""

    row: Row
    level_map: NDArray[np.float32]
    reliability: Reliability | None


def _cells(args: options.Args) -> list[Cell]:
    options.check_known(args, "methods", args.methods, identification.method_names())
    options.check_window(args)
    options.check_masks(args)
    options.check_textures(args, args.textures)
    return [
        Cell(
            method,
            identification.Setting(
                mask, sigma, None, args.levels, args.window, args.rank, args.stride
            ),
            options.images_of(args),
            options.seeds_of(args),
            args.known_noise,
            tuple(args.textures),
            args.side,
        )
        # Masks vary slowest, so that a process learns few banks.
        for mask, sigma, method in itertools.product(args.masks, args.sigmas, args.methods)
    ]


def measure(cell: Cell) -> list[Measured]:
    """Measure one cell of every texture, all its repeats."""
    return [_measure(cell, texture) for texture in cell.textures]


def _measure(cell: Cell, texture: str) -> Measured:
    setting = cell.setting
    textures = load_textures(texture, cell.images)
    errors, spreads, estimates, reliabilities = [], [], [], []
    for seed in cell.seeds:
        stair = make_stair(
            load_mask(setting.mask), textures, setting.sigma, seed, setting.levels, cell.side_px
        )
        found = cell.identify(stair.coded, stair.noise)
        # The steps are levels of the bank: whole numbers, as all estimates of the thesis are.
        found = dataclasses.replace(found, level=np.rint(found.level))
        errors.append(level_error(found.level, stair.level, setting.levels, found.confidence))
        spreads.append(spread_per_step(found.level, setting.levels))
        estimates.append(found)
        if found.confidence is not None:
            known = np.isfinite(found.level)
            right = np.abs(found.level[known] - stair.level[known]) <= 1
            reliabilities.append(Reliability.from_estimates(found.confidence[known], right))
    means, deviations = (np.array(part) for part in zip(*spreads, strict=True))
    mean = means.mean(axis=0)
    deviation = np.sqrt((deviations**2 + (means - mean) ** 2).mean(axis=0))
    noises = [found.noise for found in estimates if found.noise is not None]
    as_in_the_thesis = (setting.levels, cell.side_px) == (LEVELS, SIDE_PX)
    row = {
        "mask": setting.mask,
        "texture": texture,
        "sigma": setting.sigma,
        "noise": round(stair.noise, 6),
        "method": cell.method,
        "mean_error": mean_of((error.mean for error in errors), 3),
        "mean_error_confident_half": mean_of((error.mean_confident for error in errors), 3),
        "known": mean_of((error.known for error in errors), 4),
        "thesis_mean_error": (
            thesis_error(texture, setting.sigma, _row_of_thesis(cell.method), setting.mask)
            if as_in_the_thesis
            else None
        ),
        "noise_estimated": mean_of(noises, 6) if noises else None,
        "seconds": mean_of((found.seconds for found in estimates), 3),
        "mean_of_step": [round(float(value), 3) for value in mean],
        "deviation_of_step": [round(float(value), 3) for value in deviation],
    }
    level_map = estimates[0].level[::_MAP_STEP, ::_MAP_STEP].astype(np.float32)
    return Measured(row, level_map, Reliability.total(reliabilities) if reliabilities else None)


def _row_of_thesis(method: str) -> str:
    """Return the row of the thesis' tables that stands next to a method's numbers."""
    return (
        OUR_METHOD
        if identification.is_bank(method)
        or method in (identification.PLAIN, identification.SUBSPACE)
        else method
    )


def _results(args: options.Args, parts: list[list[Measured]]) -> Row:
    measured = list(itertools.chain(*parts))
    rows = [part.row for part in measured]
    return {
        "known_noise": args.known_noise,
        "cells": rows,
        "bank_is_beaten": lost_cells(rows),
        "reliability": [
            {
                "texture": texture,
                "method": method,
                "expected_calibration_error": round(total.expected_calibration_error, 4),
                "bins": total.rows(),
            }
            for texture, method, total in _reliabilities(measured)
        ],
    }


def lost_cells(rows: Sequence[Row]) -> list[Row]:
    """Return where a method that is not the bank has a smaller error than the bank.

    Every variant of the bank that was measured is compared.
    """
    names = ("mask", "texture", "sigma")
    banks = [row for row in rows if identification.is_bank(row["method"])]
    others = [
        row
        for row in rows
        if not identification.is_bank(row["method"]) and row["method"] != identification.PLAIN
    ]
    return [
        {
            **{name: bank[name] for name in names},
            "method": other["method"],
            "mean_error": other["mean_error"],
            "bank": bank["method"],
            "bank_mean_error": bank["mean_error"],
        }
        for bank in banks
        for other in others
        if place(other, *names) == place(bank, *names) and other["mean_error"] < bank["mean_error"]
    ]


def _reliabilities(measured: Sequence[Measured]) -> Iterator[tuple[str, str, Reliability]]:
    """Yield texture, method and the reliability over all masks and noise levels."""
    groups: dict[tuple[str, str], list[Reliability]] = {}
    for cell in measured:
        if cell.reliability is not None:
            groups.setdefault(place(cell.row, "texture", "method"), []).append(cell.reliability)
    for (texture, method), parts in groups.items():
        yield texture, method, Reliability.total(parts)


def _text(results: Row) -> str:
    """Return a table for every texture and method, masks down and noise across."""
    rows = results["cells"]
    text = tables(
        "mean error in levels / over the most confident half of the pixels [thesis, same cell; "
        "~ similar mask]",
        [
            {**row, "beside": IN_WORDS.get(_row_of_thesis(row["method"]), "not measured")}
            for row in rows
        ],
        ("texture", "method"),
        "{texture} texture, {method} [thesis: {beside}]",
        _table,
    )
    return "\n\n".join([text, *_comparison(rows, results["bank_is_beaten"])])


def _table(rows: list[Row]) -> str:
    sigmas = sorted(unique(rows, "sigma"))
    lines = []
    for (mask,), cells in grouped(rows, "mask").items():
        of_sigma = {row["sigma"]: row for row in cells}
        seconds = sum(row["seconds"] for row in cells) / len(cells)
        texts = [_cell_text(of_sigma[sigma]) for sigma in sigmas]
        lines.append([mask_with_letter(mask), *texts, f"{seconds:.1f} s"])
    return table(["mask", *(f"sigma {sigma:g}" for sigma in sigmas), "time"], lines)


def _cell_text(row: Row) -> str:
    text = f"{row['mean_error']:.2f}"
    confident = row["mean_error_confident_half"]
    if not math.isnan(confident):  # the method has a confidence
        text += f" / {confident:.2f}"
    thesis = row["thesis_mean_error"]
    return f"{text} [{'-' if thesis is None else f'{thesis:.1f}'}]"


def _comparison(rows: Sequence[Row], worse: Sequence[Row]) -> list[str]:
    methods = {row["method"] for row in rows} - {identification.PLAIN}
    if not any(map(identification.is_bank, methods)) or all(map(identification.is_bank, methods)):
        return []
    form = (
        "{method} beats {bank}: {mask}, {texture}, sigma {sigma:g}: {mean_error:.2f} against "
        "{bank_mean_error:.2f}"
    )
    lines = [form.format_map(cell) for cell in worse]
    return ["\n".join(lines) or "no other method beats the bank in any cell"]


def _draw(args: options.Args, parts: list[list[Measured]], folder: Path) -> None:
    measured = list(itertools.chain(*parts))
    for texture in args.textures:
        cells = [cell for cell in measured if cell.row["texture"] == texture]
        figures.stair_spread([cell.row for cell in cells], folder / f"spread_{texture}.png")
        for sigma in args.sigmas:
            maps: dict[str, Any] = {
                f"{cell.row['mask']}\n{cell.row['method']}": cell.level_map
                for cell in cells
                if cell.row["sigma"] == sigma
            }
            figures.stair_maps(maps, args.levels, folder / f"maps_{texture}_{sigma:g}.png")
    curves = {f"{texture}, {method}": total for texture, method, total in _reliabilities(measured)}
    if curves:
        path = folder / "reliability.png"
        reliability_diagram(curves, path, "right to one level (all masks and noises)")


SUITE = Suite(
    name="stair",
    said=("textures", "images", "levels", "side", "window", "repeats", "seed"),
    description="Mean error, in levels, of the blur that is identified on a column of crops, "
    "each blurred with the next of 39 sizes from 7 to 30 px (M. Martinello, Coded Aperture "
    "Imaging, PhD thesis, 2012, section 6.3.1). All pixels count, those at the boundaries of "
    "steps too.",
    examples="""examples:
  two masks, four noise levels, with and without graph cuts, next to the numbers of the thesis:
    coded_aperture bench accuracy stair
  one mask against the reference methods, with figures:
    coded_aperture bench accuracy stair --masks levin --sigmas 0 0.001 \\
        --methods bank wiener levin --output results/
  photographs of your own at half size, a stair of 9 small steps:
    coded_aperture bench accuracy stair --images photographs/ --textures soft --levels 9 \\
        --side 64 --window 48
""",
    options=(
        options.TEXTURE_LIST,
        options.STEP_SIDE,
        *options.generated(
            (0.0, 0.001, 0.002, 0.005),
            2,
            ("bank", "bank-semiglobal", "bank-graphcut"),
            _WINDOW_PX,
            _RANK,
        ),
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
