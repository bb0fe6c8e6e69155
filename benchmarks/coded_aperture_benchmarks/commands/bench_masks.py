"""`coded_aperture bench masks`: predicted against measured errors of random masks."""

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_cells import measure_cells
from coded_aperture_benchmarks.commands.bench_options import (
    add_images_option,
    add_result_options,
    check_result_options,
    report,
)
from coded_aperture_benchmarks.commands.bench_stair import Cell, measure_cell
from coded_aperture_ros.cli.options import add_numbers, add_sigmas_option, folder_of, table
from coded_aperture_ros.cli.progress import progress

# Of the crops to predict from: the stairs have seeds from 0 on.
_CROPS_SEED = 1000
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
        "does, from the mask alone and from other crops of the pictures that are measured, "
        "measure it on the stair of the thesis (natural texture, not regularised), and "
        "report how well the ranks agree (Spearman's correlation); and how many masks a second "
        "are scored from the mask alone.",
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
        ("windows", 1, 768, "windows of pictures to predict from, cut from columns like a stair's"),
    )
    add_sigmas_option(parser, (0.001, 0.005), ", above 0")
    add_images_option(parser)
    add_result_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    import numpy as np

    from coded_aperture_benchmarks.commands.bench_methods import BANK, Setting
    from coded_aperture_benchmarks.random_masks import random_masks
    from coded_aperture_ros.mask_design import MaskScorer

    if args.window % 2:
        args.usage_error(f"--window: expected an even number, got {args.window}")
    check_result_options(args)
    masks = random_masks(args.count, args.seed)
    scorer = MaskScorer(sigmas=args.sigmas)
    predicted = scorer.score(masks)
    images = folder_of(args.images)
    with_pictures = _with_pictures(args, masks)
    with tempfile.TemporaryDirectory() as folder:
        cells = []
        for mask in masks:
            path = Path(folder) / f"{mask.name}.npy"
            np.save(path, mask.transmission)
            for sigma in args.sigmas:
                setting = Setting(str(path), sigma, None, args.levels, args.window, args.rank, None)
                seeds = tuple(range(args.repeats))
                cells.append(Cell(("natural",), BANK, setting, images, seeds, args.side, False))
        rows = [
            part.row for parts in measure_cells(measure_cell, cells, args.jobs) for part in parts
        ]
    measured = np.array([row["mean_error"] for row in rows]).reshape(len(masks), -1)
    results = {
        "benchmark": "masks",
        "images": args.images,
        "windows": args.windows,
        "rank_correlation": _rank_correlation(args.sigmas, predicted.depth_error, measured),
        "rank_correlation_pictures": _rank_correlation(args.sigmas, with_pictures, measured),
        "masks_per_second": round(_masks_per_second(scorer)),
        "masks": [
            {
                "mask": mask.name,
                "cells": len(mask.transmission),
                "light": round(mask.open_fraction, 3),
                "predicted": _rounded(predicted.depth_error[index]),
                "predicted_pictures": _rounded(with_pictures[index]),
                "measured": _rounded(measured[index]),
            }
            for index, mask in enumerate(masks)
        ],
    }
    report(args, results, lambda: _text(results, args.sigmas))
    return 0


def _with_pictures(args: argparse.Namespace, masks: Sequence[Any]) -> Any:
    """Return depth errors predicted from columns of crops, as the stairs are [masks, noises]."""
    import numpy as np

    from coded_aperture_benchmarks.random_masks import patches_of_columns
    from coded_aperture_benchmarks.stair import LARGEST_BLUR_PX, SMALLEST_BLUR_PX
    from coded_aperture_ros.io.textures import load_textures
    from coded_aperture_ros.mask_design import PictureScorer, SceneConfig
    from coded_aperture_ros.mask_design.pictures import patch_side_px

    scene = SceneConfig(
        levels=args.levels, smallest_px=SMALLEST_BLUR_PX, largest_px=LARGEST_BLUR_PX
    )
    textures = load_textures("natural", folder_of(args.images))
    side = patch_side_px(scene, args.window)
    patches = patches_of_columns(textures, args.windows, side, args.side, _CROPS_SEED)
    scorer = PictureScorer(patches, scene, args.sigmas, window_px=args.window)
    return np.array([scorer.depth_error(mask) for mask in progress(masks, len(masks), "mask")])


def _rank_correlation(sigmas: Sequence[float], predicted: Any, measured: Any) -> dict[str, float]:
    """Return Spearman's correlation over the masks, at every noise."""
    from scipy.stats import spearmanr

    return {
        f"{sigma:g}": round(float(spearmanr(predicted[:, i], measured[:, i])[0]), 3)
        for i, sigma in enumerate(sigmas)
    }


def _rounded(values: Any) -> list[float]:
    return [round(float(value), 3) for value in values]


def _masks_per_second(scorer: Any) -> float:
    """Return how fast one processor scores random masks of 11x11 cells at 30 levels."""
    import numpy as np

    from coded_aperture_ros.mask_design.grids import random_grids

    grids = random_grids(512, 11, 1, "none", np.random.default_rng(0)).astype(np.float32)
    scorer.score_grids(grids[:64])
    start = time.process_time()
    scorer.score_grids(grids)
    return len(grids) / (time.process_time() - start)


def _text(results: dict[str, Any], sigmas: list[float]) -> str:
    header = ["mask", "cells", "light"]
    columns = {"predicted": "predicted", "pictures": "predicted_pictures", "measured": "measured"}
    header += [f"{title} {sigma:g}" for title in columns for sigma in sigmas]
    lines = [
        [
            row["mask"],
            str(row["cells"]),
            f"{row['light']:.2f}",
            *(f"{value:.2f}" for name in columns.values() for value in row[name]),
        ]
        for row in results["masks"]
    ]
    return (
        f"{table(header, lines)}\nrank correlation with the measured error, of what is predicted\n"
        f"  from the mask alone: {_ranks_text(results['rank_correlation'])}\n"
        f"  from other crops of the pictures: {_ranks_text(results['rank_correlation_pictures'])}\n"
        f"{results['masks_per_second']} masks of 11x11 cells a second from the mask alone, on one "
        "processor"
    )


def _ranks_text(ranks: dict[str, float]) -> str:
    return ", ".join(f"{value:.2f} at sigma {sigma}" for sigma, value in ranks.items())
