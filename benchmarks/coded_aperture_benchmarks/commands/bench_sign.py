"""`coded_aperture bench sign`: the two sides of the focal plane, told apart."""

import argparse
import dataclasses
import itertools
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_cells import measure_cells
from coded_aperture_benchmarks.commands.bench_methods import bank_methods
from coded_aperture_benchmarks.commands.bench_options import (
    add_images_option,
    add_masks_option,
    add_result_options,
    check_result_options,
    report,
)
from coded_aperture_ros.cli.options import add_numbers, add_sigmas_option, folder_of, mask_of, table

_SCENE_REACH_PX = 12.0
# Learned for a little more than what there is to see.
_RANGE_MARGIN = 0.02
_MASKS = ("zhou", "three_wide", "three_hole", "veeraraghavan", "disc", "levin")
_EPILOG = """examples:
  planes on both sides, through masks that are symmetric under a half turn and others:
    coded_aperture bench sign
  two masks on a few planes, also of each patch by itself:
    coded_aperture bench sign --masks zhou disc --planes 9 --levels 17 --regularize none semiglobal
  the sharp pictures and depths of ray-traced scenes, with the focus in their middle:
    coded_aperture bench sign --masks zhou three_wide --scenes desk/ corridor/ --output results/
"""


@dataclasses.dataclass(frozen=True)
class Cell:
    """One mask on planes, or on a scene."""

    mask: str
    scene: Path | None
    sigma: float
    regularize: str
    levels: int
    planes: int
    repeats: int
    seed: int
    images: str | None


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a cell, for JSON, and the maps of a scene, to be drawn."""

    row: dict[str, Any]
    maps: dict[str, Any]


def add_parser(subparsers: Any) -> None:
    """Add the benchmark to the parser of `bench`."""
    parser = subparsers.add_parser(
        "sign",
        help="the two sides of the focal plane, told apart",
        description="Measure how often the side of the focal plane is right, on simulated planes "
        "of 320x240 px with photographs as texture, blurred by -20 to 20 px, or on scenes that are "
        "focused in their middle; and the error of the signed levels beside that of one estimator "
        "for each side, who is told the side of every pixel.",
        epilog=_EPILOG,
    )
    add_masks_option(parser, _MASKS)
    add_sigmas_option(parser, (0.001,))
    parser.add_argument(
        "--regularize",
        nargs="+",
        default=["semiglobal"],
        metavar="HOW",
        help="none, semiglobal, ... (default semiglobal)",
    )
    add_numbers(
        parser,
        ("levels", 3, 41, "blur levels, of both sides together"),
        ("planes", 2, 40, "blur sizes of planes, equally spaced from -20 to 20 px"),
        ("repeats", 1, 1, "planes of every blur size"),
        ("seed", 0, 0, "of crops and noise"),
    )
    add_images_option(parser)
    parser.add_argument(
        "--scenes",
        nargs="+",
        type=Path,
        default=[None],
        metavar="FOLDER",
        help="instead of planes: sharp picture and depth of ray-traced scenes (see bench accuracy "
        f"scenes), seen by a camera with blur of {_SCENE_REACH_PX:g} px at both ends of the depths",
    )
    add_result_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    check_result_options(args)
    for mask in args.masks:
        mask_of(mask)
    for how in args.regularize:
        if how not in bank_methods().values():
            args.usage_error(
                f"--regularize: unknown {how!r}, use some of {', '.join(bank_methods().values())}"
            )
    cells = [
        Cell(
            mask, scene, sigma, how, args.levels, args.planes, args.repeats, args.seed, args.images
        )
        for scene, mask, sigma, how in itertools.product(
            args.scenes, args.masks, args.sigmas, args.regularize
        )
    ]
    start = time.perf_counter()
    measured = measure_cells(measure_cell, cells, args.jobs)
    results = {
        "benchmark": "sign",
        "levels": args.levels,
        "seed": args.seed,
        "seconds": round(time.perf_counter() - start, 1),
        "cells": [each.row for each in measured],
    }
    draw = (lambda folder: _draw(measured, folder)) if args.scenes != [None] else None
    report(args, results, lambda: _text(results["cells"]), draw)
    return 0


def measure_cell(cell: Cell) -> Measured:
    """Measure one mask on planes or on a scene."""
    from coded_aperture_benchmarks.sides import SideEstimators, SideScore, plane_camera
    from coded_aperture_ros.depth import DepthConfig

    mask = mask_of(cell.mask)
    config = DepthConfig(regularize=cell.regularize)
    if cell.scene is None:
        camera, near_m, far_m = plane_camera(mask)
        frames = _planes(cell, camera)
    else:
        frame, camera, near_m, far_m = _scene(cell, cell.scene, mask)
        frames = iter([frame])
    estimators = SideEstimators(camera, near_m, far_m, cell.levels, config)
    estimates, seconds = [], []
    for frame in frames:
        estimates.append(estimators.estimate(frame))
        seconds.append(estimates[-1].both.seconds["side"])
    threshold = estimators.threshold
    score = SideScore.of(estimates, estimators.step_px, threshold)
    row = {
        "scene": "planes" if cell.scene is None else cell.scene.resolve().name,
        "mask": cell.mask,
        "asymmetry": round(mask.asymmetry, 3),
        "sigma": cell.sigma,
        "regularize": cell.regularize,
        **{name: round(value, 4) for name, value in dataclasses.asdict(score).items()},
        "seconds_for_the_side": round(sum(seconds) / len(seconds), 3),
    }
    maps = {}
    if cell.scene is not None:
        last = estimates[-1]
        known = last.both.where_confident(threshold)
        maps = {
            "true": last.frame.blur_size_px,
            "side told": last.told_size_px,
            "estimated": last.both.blur_size_px,
            "confident": known.blur_size_px,
        }
    return Measured(row, maps)


def _planes(cell: Cell, camera: Any) -> Any:
    import numpy as np

    from coded_aperture_benchmarks import load_textures
    from coded_aperture_benchmarks.sides import REACH_PX, make_planes_on_both_sides

    textures = load_textures("natural", folder_of(cell.images))
    sizes = np.linspace(-REACH_PX, REACH_PX, cell.planes)
    for repeat in range(cell.repeats):
        yield from make_planes_on_both_sides(
            camera, textures, sizes, cell.sigma, cell.seed + repeat
        )


def _scene(cell: Cell, folder: Path, mask: Any) -> tuple[Any, Any, float, float]:
    """Return a coded frame of a scene, its camera and the ends of the depths that are learned."""
    from coded_aperture_benchmarks.ray_traced import load_sharp
    from coded_aperture_benchmarks.sides import focused_between, make_scene_on_both_sides

    sharp, depth_m = load_sharp(folder)
    near_m, far_m = float(depth_m.min()), float(depth_m.max())
    camera = focused_between(mask, near_m, far_m, depth_m.shape, _SCENE_REACH_PX)
    frame = make_scene_on_both_sides(sharp, depth_m, camera, cell.sigma, cell.seed)
    return frame, camera, near_m * (1 - _RANGE_MARGIN), far_m * (1 + _RANGE_MARGIN)


def _text(rows: Sequence[dict[str, Any]]) -> str:
    header = [
        "frames", "mask", "asymmetry", "sigma", "regularize", "side right", "confident",
        "of it right", "said", "level error", "side told", "confident", "side told",
        "depth error", "side told", "time",
    ]  # fmt: skip
    shares = ("right", "confident", "confident_right", "confident_said")
    errors = (
        "level_error",
        "told_level_error",
        "confident_level_error",
        "told_confident_level_error",
    )
    lines = [
        [
            row["scene"],
            row["mask"],
            f"{row['asymmetry']:.2f}",
            f"{row['sigma']:g}",
            row["regularize"],
            *(f"{100 * row[name]:.1f} %" for name in shares),
            *(f"{row[name]:.2f}" for name in errors),
            *(f"{100 * row[name]:.1f} %" for name in ("depth_error", "told_depth_error")),
            f"{row['seconds_for_the_side']:.2f} s",
        ]
        for row in rows
    ]
    return (
        "side right: share of the pixels with 2 px of blur or more on the right side of the focal "
        "plane; confident:\nthose whose depth is confident, how many of these are right, and how "
        "many it was said would be\nlevel error: mean, of all pixels, and of the confident ones; "
        "depth error: median, relative, of these; side\ntold: by one estimator for each side\n\n"
        + table(header, lines)
    )


def _draw(measured: Sequence[Measured], folder: Path) -> None:
    from coded_aperture_benchmarks import plots

    for each in measured:
        name = "_".join(str(each.row[key]) for key in ("scene", "mask", "sigma", "regularize"))
        plots.signed_blur_maps(each.maps, folder / f"{Path(name).name}.png")
