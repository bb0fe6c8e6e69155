"""Blur identification at an occluding edge."""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import figures, options
from coded_aperture_benchmarks.arguments import at_least
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.datasets.two_plane import make_two_planes, two_plane_error
from coded_aperture_benchmarks.methods import identification
from coded_aperture_benchmarks.rows import mean_of, place
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.thesis.stair import with_middle
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.optics import load_mask

_PLACE = ("mask", "front_blur_px", "back_blur_px", "sigma")
_COLUMNS = {
    "mask": "{mask}",
    "blurs px": "{front_blur_px:g}, {back_blur_px:g}",
    "sigma": "{sigma:g}",
    "method": "{method}",
    "all pixels": "{mean_error:.2f}",
    "within 16 px": "{mean_error_near_edge:.2f}",
    "beyond": "{mean_error_beyond:.2f}",
    f"within / {identification.PLAIN}": "{near_edge_over_plain:.2f}",
    "time": "{seconds:.1f} s",
}


@dataclasses.dataclass(frozen=True)
class Cell(identification.MethodOnFrames):
    """One row of the table."""

    blurs_px: tuple[float, float]
    texture: str
    shape: tuple[int, int]


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a cell, and for a figure the mean and the true level of every column."""

    row: Row
    across: NDArray[np.float64]
    truth: NDArray[np.float32]


def _cells(args: options.Args) -> list[Cell]:
    options.check_known(args, "methods", args.methods, identification.method_names())
    options.check_window(args)
    options.check_masks(args)
    options.check_textures(args, [args.texture])
    methods = list(dict.fromkeys([identification.PLAIN, *args.methods]))
    return [
        Cell(
            method,
            identification.Setting(
                mask, sigma, None, args.levels, args.window, args.rank, args.stride
            ),
            options.images_of(args),
            options.seeds_of(args),
            args.known_noise,
            blurs_px,
            args.texture,
            (args.size[0], args.size[1]),
        )
        for mask, sigma, blurs_px, method in itertools.product(
            args.masks, args.sigmas, args.blurs, methods
        )
    ]


def measure(cell: Cell) -> Measured:
    """Measure one cell, all its repeats."""
    setting = cell.setting
    mask = load_mask(setting.mask)
    textures = load_textures(cell.texture, cell.images)
    errors, profiles, seconds = [], [], []
    for seed in cell.seeds:
        truth = make_two_planes(
            mask, textures, *cell.blurs_px, setting.sigma, seed, setting.levels, cell.shape
        )
        found = cell.identify(truth.coded, truth.noise)
        errors.append(two_plane_error(found.level, truth))
        profiles.append(with_middle(found.level, setting.levels).mean(axis=0))
        seconds.append(found.seconds)
    row = {
        "mask": setting.mask,
        "front_blur_px": cell.blurs_px[0],
        "back_blur_px": cell.blurs_px[1],
        "sigma": setting.sigma,
        "noise": round(truth.noise, 6),
        "method": cell.method,
        "mean_error": mean_of((error.everywhere for error in errors), 3),
        "mean_error_near_edge": mean_of((error.near_edge for error in errors), 3),
        "mean_error_beyond": mean_of((error.beyond for error in errors), 3),
        "seconds": mean_of(seconds, 3),
    }
    return Measured(row, np.mean(profiles, axis=0), truth.level[0])


def _results(args: options.Args, measured: list[Measured]) -> Row:
    return {
        "rows": args.size[0],
        "columns": args.size[1],
        "cells": compared_with_plain([cell.row for cell in measured]),
    }


def compared_with_plain(rows: Sequence[Row]) -> list[Row]:
    """Return the rows with their error near the edge over that of the plain window."""
    plain = {place(row, *_PLACE): row for row in rows if row["method"] == identification.PLAIN}

    def ratio(row: Row) -> float:
        of_plain = plain[place(row, *_PLACE)]["mean_error_near_edge"]
        return row["mean_error_near_edge"] / of_plain if of_plain else float("nan")

    return [{**row, "near_edge_over_plain": round(ratio(row), 3)} for row in rows]


def _text(results: Row) -> str:
    return f"mean error in levels\n{columns(results['cells'], _COLUMNS)}"


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    panels: dict[str, dict[str, NDArray[np.float64]]] = {}
    truths = {}
    title = "{mask}, {front_blur_px:g} and {back_blur_px:g} px, sigma {sigma:g}"
    for cell in measured:
        panel = title.format_map(cell.row)
        panels.setdefault(panel, {})[cell.row["method"]] = cell.across
        truths[panel] = cell.truth
    figures.edge_profiles(panels, truths, folder / "edges.png")


def _pair(text: str) -> tuple[float, float]:
    front, back = (float(part) for part in text.split(","))
    return front, back


_pair.__name__ = "pair of sizes"  # argparse says "invalid pair of sizes value"

SUITE = Suite(
    name="two-plane",
    said=("texture", "images", "levels", "window", "repeats", "seed", "known_noise"),
    description="Mean error, in levels, of the blur that is identified on two textured planes "
    "with a straight edge between, rendered with exact occlusion: over all pixels, within 16 px "
    "of the edge, and beyond. The truth is what a pinhole sees. A bank with a plain window of "
    "48 px is always measured, for comparison.",
    examples="""examples:
  two pairs of planes, with and without regularisation, next to a plain window of 48 px:
    coded_aperture bench accuracy two-plane
  planes with a blur of 8 and 12 px, figures of the error across the edge:
    coded_aperture bench accuracy two-plane --blurs 8,12 --methods bank-graphcut --output results/
""",
    options=(
        options.option(
            "--blurs",
            "blur sizes of the two planes in px",
            [(10.0, 14.0), (10.0, 22.0)],
            said="10,14 10,22",
            type=_pair,
            metavar="FRONT,BACK",
        ),
        options.option(
            "--texture",
            "unselected crops of photographs, the same at half size, or white noise",
            "natural",
            choices=options.TEXTURES,
        ),
        options.option(
            "--size",
            "of a frame",
            [320, 480],
            nargs=2,
            type=at_least(64),
            metavar=("ROWS", "COLUMNS"),
        ),
        # Window and rank as the command learn.
        *options.generated(
            (0.001,), 4, ("bank", "bank-semiglobal", "bank-tv", "bank-graphcut"), 48, 128
        ),
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
