"""`coded_aperture bench motion table`: defocus, direction and length of motion, table 7.1."""

import argparse
import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

from coded_aperture_benchmarks.commands.bench_cells import measure_cells
from coded_aperture_benchmarks.commands.bench_options import (
    add_cases_option,
    add_result_options,
    check_result_options,
    report,
)
from coded_aperture_ros.cli.options import add_numbers, table

_MASKS = ("disc", "A", "B", "C")
_TEXTURES = ("random", "natural", "soft")
_CASES = (("random", 0.0), ("random", 0.0005), ("natural", 0.0), ("natural", 0.0005))
_PARAMETERS = ("defocus", "direction", "length")
_EXACT = 4096
_EPILOG = """examples:
  the table of the thesis, and natural texture:
    coded_aperture bench motion table
  two masks, all hypotheses exact, which takes twice as long as frames can:
    coded_aperture bench motion table --masks disc C --cases random,0.0005 --exact
"""


@dataclasses.dataclass(frozen=True)
class Cell:
    """One mask with one texture and noise."""

    mask: str
    texture: str
    sigma: float
    window_px: int
    exact: bool
    seed: int


def add_parser(subparsers: Any) -> None:
    """Add these frames to the parser of `bench motion`."""
    parser = subparsers.add_parser(
        "table",
        help="planes that move, as in the thesis",
        description="Mean error and accuracy of defocus, direction and length of motion on 640 "
        "images of 70x70 px: 10 blur sizes, 8 directions, 8 lengths (M. Martinello, Coded Aperture "
        "Imaging, PhD thesis, 2012, table 7.1), with a disc, and with the masks A, B and C that "
        "the analysis of fragmentation finds (see mask motion).",
        epilog=_EPILOG,
    )
    parser.add_argument(
        "--masks",
        nargs="+",
        choices=_MASKS,
        default=list(_MASKS),
        metavar="MASK",
        help=f"some of {', '.join(_MASKS)} (default all)",
    )
    add_cases_option(parser, _TEXTURES, _CASES, "open third of the masks")
    add_numbers(parser, ("window", 40, 48, "side of the windows, px"))
    parser.add_argument(
        "--exact",
        action="store_true",
        help="no common basis: all motions under all textures (default: as frames are worked on)",
    )
    add_numbers(parser, ("seed", 0, 0, "of crops and noise"))
    add_result_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    if args.window % 2:
        args.usage_error(f"--window: expected an even number, got {args.window}")
    check_result_options(args)
    cells = [
        Cell(mask, texture, sigma, args.window, args.exact, args.seed)
        for (texture, sigma), mask in itertools.product(args.cases, args.masks)
    ]
    rows = measure_cells(measure_cell, cells, args.jobs)
    report(args, {"benchmark": "motion table", "cells": rows}, lambda: _table(rows))
    return 0


def measure_cell(cell: Cell) -> dict[str, Any]:
    """Measure one mask with one texture and noise."""
    from coded_aperture_benchmarks.motion_table import TABLE_7_1, identify_motions, table_masks
    from coded_aperture_ros.io.textures import load_textures
    from coded_aperture_ros.methods.motion import MotionConfig

    mask = table_masks()[0][cell.mask]
    config = MotionConfig(motion_rank=_EXACT) if cell.exact else MotionConfig()
    found = identify_motions(
        mask, load_textures(cell.texture), cell.sigma, cell.window_px, config, cell.seed
    )
    return {
        "mask": cell.mask,
        "pattern": mask.name,
        "texture": cell.texture,
        "sigma": cell.sigma,
        **{
            name: {
                "mean_error": round(found[name].mean_error, 3),
                "accuracy": round(found[name].accuracy, 4),
                "thesis": thesis if cell.texture == "random" else None,
            }
            for name, thesis in zip(_PARAMETERS, TABLE_7_1[cell.mask], strict=True)
        },
    }


def _table(rows: Sequence[dict[str, Any]]) -> str:
    parts = ["mean error / accuracy [thesis, table 7.1]"]
    for texture, sigma in dict.fromkeys((row["texture"], row["sigma"]) for row in rows):
        here = [row for row in rows if (row["texture"], row["sigma"]) == (texture, sigma)]
        lines = [
            [f"{row['mask']} {row['pattern']}", *(_text(row[name]) for name in _PARAMETERS)]
            for row in here
        ]
        header = ["mask", *_PARAMETERS]
        parts.append(f"{texture} texture, sigma {sigma:g}\n{table(header, lines)}")
    return "\n\n".join(parts)


def _text(found: dict[str, Any]) -> str:
    text = f"{found['mean_error']:.2f} / {100 * found['accuracy']:.1f} %"
    if found["thesis"] is None:
        return text
    error, accuracy = found["thesis"]
    return f"{text} [{error:.2f} / {100 * accuracy:.1f} %]"
