"""`coded_aperture bench masks`: predicted against measured errors of random masks."""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.bench_cells import measure_cells
from coded_aperture_ros.cli.bench_options import (
    add_numbers,
    add_result_options,
    add_sigmas_option,
    check_result_options,
    report,
    table,
)
from coded_aperture_ros.cli.bench_stair import Cell, measure_cell

_EPILOG = """examples:
  30 random masks, two noises:
    coded_aperture bench masks
  six masks on a small stair:
    coded_aperture bench masks --count 6 --levels 9 --side 48 --window 48 --rank 64
"""


def add_parser(subparsers: Any) -> None:
    """Add the benchmark to the parser of `bench`."""
    parser = subparsers.add_parser(
        "masks",
        help="predicted against measured errors of random masks",
        description="Predict the depth error of random masks of 7x7 to 13x13 cells as mask score "
        "does, measure it on the stair of the thesis (natural texture, not regularised), and "
        "report how well the ranks agree (Spearman's correlation); and how many masks a second "
        "are scored.",
        epilog=_EPILOG,
    )
    add_numbers(
        parser,
        ("count", 3, 30, "random masks"),
        ("seed", 0, 0, "of the masks"),
        ("repeats", 1, 2, "stairs to take the mean over"),
        ("levels", 2, 39, "blur sizes, equally spaced from 7 to 30 px"),
        ("side", 16, 125, "of a step, px"),
        ("window", 16, 96, "side of the bank's patches, px"),
        ("rank", 1, 400, "vectors in the bank's common basis"),
    )
    add_sigmas_option(parser, (0.001, 0.005), ", above 0")
    add_result_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    import numpy as np
    from scipy.stats import spearmanr

    from coded_aperture_ros.cli.bench_methods import BANK, Setting
    from coded_aperture_ros.masks import MaskScorer
    from coded_aperture_ros.masks.grids import random_masks

    if args.window % 2:
        args.usage_error(f"--window: expected an even number, got {args.window}")
    check_result_options(args)
    masks = random_masks(args.count, args.seed)
    scorer = MaskScorer(sigmas=args.sigmas)
    predicted = scorer.score(masks)
    with tempfile.TemporaryDirectory() as folder:
        cells = []
        for mask in masks:
            path = Path(folder) / f"{mask.name}.npy"
            np.save(path, mask.transmission)
            for sigma in args.sigmas:
                setting = Setting(str(path), sigma, None, args.levels, args.window, args.rank, None)
                seeds = tuple(range(args.repeats))
                cells.append(Cell(("natural",), BANK, setting, None, seeds, args.side, False))
        rows = [
            part.row for parts in measure_cells(measure_cell, cells, args.jobs) for part in parts
        ]
    measured = np.array([row["mean_error"] for row in rows]).reshape(len(masks), -1)
    ranks = {
        f"{sigma:g}": round(float(spearmanr(predicted.depth_error[:, i], measured[:, i])[0]), 3)
        for i, sigma in enumerate(args.sigmas)
    }
    results = {
        "benchmark": "masks",
        "rank_correlation": ranks,
        "masks_per_second": round(_masks_per_second(scorer)),
        "masks": [
            {
                "mask": mask.name,
                "cells": len(mask.transmission),
                "light": round(mask.open_fraction, 3),
                "predicted": [round(float(value), 3) for value in predicted.depth_error[index]],
                "measured": [round(float(value), 3) for value in measured[index]],
            }
            for index, mask in enumerate(masks)
        ],
    }
    report(args, results, lambda: _text(results, args.sigmas))
    return 0


def _masks_per_second(scorer: Any) -> float:
    """Return how fast one processor scores random masks of 11x11 cells at 30 levels."""
    import numpy as np

    from coded_aperture_ros.masks.grids import random_grids

    grids = random_grids(512, 11, 1, "none", np.random.default_rng(0)).astype(np.float32)
    scorer.score_grids(grids[:64])
    start = time.process_time()
    scorer.score_grids(grids)
    return len(grids) / (time.process_time() - start)


def _text(results: dict[str, Any], sigmas: list[float]) -> str:
    header = ["mask", "cells", "light"]
    header += [f"{what} {sigma:g}" for what in ("predicted", "measured") for sigma in sigmas]
    lines = [
        [
            row["mask"],
            str(row["cells"]),
            f"{row['light']:.2f}",
            *(f"{value:.2f}" for value in (*row["predicted"], *row["measured"])),
        ]
        for row in results["masks"]
    ]
    ranks = ", ".join(
        f"{value:.2f} at sigma {sigma}" for sigma, value in results["rank_correlation"].items()
    )
    return (
        f"{table(header, lines)}\nrank correlation of predicted and measured error: {ranks}\n"
        f"{results['masks_per_second']} masks of 11x11 cells a second, on one processor"
    )
