"""Predicted against measured errors of random masks."""

import dataclasses
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.random_masks import patches_of_columns, random_masks
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.methods.identification import BANK, Setting
from coded_aperture_benchmarks.options import sigmas
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.thesis.stair import LARGEST_BLUR_PX, SMALLEST_BLUR_PX
from coded_aperture_benchmarks.thesis.suites import stair
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.design.scores.pictures import PictureScorer, patch_side_px
from coded_aperture_ros.design.scores.predict import MaskScorer
from coded_aperture_ros.design.scores.spectra import SceneConfig
from coded_aperture_ros.design.search.grids import random_grids
from coded_aperture_ros.optics import Mask

# Of the crops to predict from: the stairs have seeds from 0 on.
_CROPS_SEED = 1000


@dataclasses.dataclass(frozen=True)
class Cell:
    """A mask on a stair at all noises; the stair's setting has neither yet."""

    mask: Mask
    sigmas: tuple[float, ...]
    setting: Setting
    images: Path | None
    repeats: int
    side_px: int


def _cells(args: options.Args) -> list[Cell]:
    options.check_window(args)
    options.check_textures(args, ["natural"])
    MaskScorer(sigmas=args.sigmas)  # refuses what it cannot score
    setting = Setting("", 0.0, None, args.levels, args.window, args.rank)
    return [
        Cell(mask, tuple(args.sigmas), setting, options.images_of(args), args.repeats, args.side)
        for mask in random_masks(args.count, args.seed)
    ]


def measure(cell: Cell) -> list[float]:
    """Measure the mean error on the stair at every noise."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{cell.mask.name}.npy"
        np.save(path, cell.mask.transmission)
        settings = [
            dataclasses.replace(cell.setting, mask=str(path), sigma=sigma) for sigma in cell.sigmas
        ]
        seeds = tuple(range(cell.repeats))
        parts = [
            stair.measure(
                stair.Cell(BANK, setting, cell.images, seeds, False, ("natural",), cell.side_px)
            )
            for setting in settings
        ]
    return [part.row["mean_error"] for (part,) in parts]


def _results(args: options.Args, errors: list[list[float]]) -> Row:
    masks = random_masks(args.count, args.seed)
    scorer = MaskScorer(sigmas=args.sigmas)
    predicted = scorer.score(masks).depth_error
    with_pictures, measured = _with_pictures(args, masks), np.array(errors)
    return {
        "rank_correlation": _rank_correlation(args.sigmas, predicted, measured),
        "rank_correlation_pictures": _rank_correlation(args.sigmas, with_pictures, measured),
        "masks_per_second": round(_masks_per_second(scorer)),
        "masks": [
            {
                "mask": mask.name,
                "cells": len(mask.transmission),
                "light": round(mask.open_fraction, 3),
                "predicted": _rounded(predicted[index]),
                "predicted_pictures": _rounded(with_pictures[index]),
                "measured": _rounded(measured[index]),
            }
            for index, mask in enumerate(masks)
        ],
    }


def _with_pictures(args: options.Args, masks: Sequence[Mask]) -> NDArray[np.float64]:
    """Return depth errors predicted from columns of crops, as the stairs are [masks, noises]."""
    scene = SceneConfig(
        levels=args.levels, smallest_px=SMALLEST_BLUR_PX, largest_px=LARGEST_BLUR_PX
    )
    textures = load_textures("natural", options.images_of(args))
    side = patch_side_px(scene, args.window)
    patches = patches_of_columns(textures, args.windows, side, args.side, _CROPS_SEED)
    scorer = PictureScorer(patches, scene, args.sigmas, window_px=args.window)
    return np.array([scorer.depth_error(mask) for mask in progress(masks, len(masks), "mask")])


def _rank_correlation(
    noises: Sequence[float], predicted: NDArray[np.floating], measured: NDArray[np.floating]
) -> dict[str, float]:
    """Return Spearman's correlation over the masks, at every noise."""
    return {
        f"{sigma:g}": round(float(spearmanr(predicted[:, i], measured[:, i])[0]), 3)
        for i, sigma in enumerate(noises)
    }


def _rounded(values: NDArray[np.floating]) -> list[float]:
    return [round(float(value), 3) for value in values]


def _masks_per_second(scorer: MaskScorer) -> float:
    """Return how fast one processor scores random masks of 11x11 cells at 30 levels."""
    grids = random_grids(512, 11, 1, "none", np.random.default_rng(0)).astype(np.float32)
    scorer.score_grids(grids[:64])
    start = time.process_time()
    scorer.score_grids(grids)
    return len(grids) / (time.process_time() - start)


def _text(results: Row) -> str:
    described = {"mask": "{mask}", "cells": "{cells}", "light": "{light:.2f}"}
    ranks = results["rank_correlation"]
    for title, name in (
        ("predicted", "predicted"),
        ("pictures", "predicted_pictures"),
        ("measured", "measured"),
    ):
        for index, sigma in enumerate(ranks):
            described[f"{title} {sigma}"] = f"{{{name}[{index}]:.2f}}"
    return (
        f"{columns(results['masks'], described)}\n"
        "rank correlation with the measured error, of what is predicted\n"
        f"  from the mask alone: {_ranks_text(ranks)}\n"
        f"  from other crops of the pictures: {_ranks_text(results['rank_correlation_pictures'])}\n"
        f"{results['masks_per_second']} masks of 11x11 cells a second from the mask alone, on one "
        "processor"
    )


def _ranks_text(ranks: dict[str, float]) -> str:
    return ", ".join(f"{value:.2f} at sigma {sigma}" for sigma, value in ranks.items())


SUITE = Suite(
    name="masks",
    said=("images", "windows"),
    description="Predict the depth error of random masks of 7x7 to 13x13 cells as mask score does, "
    "from the mask alone and from other crops of the pictures that are measured, measure it on "
    "the stair of the thesis (natural texture, not regularised), and report how well the ranks "
    "agree (Spearman's correlation); and how many masks a second are scored from the mask alone.",
    examples="""examples:
  30 random masks, two noises:
    python -m coded_aperture_benchmarks masks
  six masks on a small stair:
    python -m coded_aperture_benchmarks masks --count 6 --levels 9 --side 48 --window 48 --rank 64
""",
    options=(
        options.number("--count", 3, 30, "random masks"),
        options.number("--seed", 0, 0, "of the masks"),
        options.number("--repeats", 1, 2, "stairs to take the mean over"),
        options.blur_levels(39),
        options.number("--side", 16, 125, "of a step, px"),
        options.number("--window", 16, 96, "side of the bank's patches, px"),
        options.number("--rank", 1, 400, "vectors in the bank's common basis"),
        options.number(
            "--windows",
            1,
            768,
            "windows of pictures to predict from, cut from columns like a stair's",
        ),
        sigmas((0.001, 0.005), ", above 0"),
        options.IMAGES,
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
