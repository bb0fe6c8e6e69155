"""`coded_aperture bench accuracy scenes`: metric depth of ray-traced scenes."""

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
    add_result_options,
    check_result_options,
    report,
)
from coded_aperture_ros.cli.options import at_least, noise_level, table
from coded_aperture_ros.core.errors import InputError

_NOISE = 0.002
_LEVELS = 30
# Learned for a little more than what there is to see.
_RANGE_MARGIN = 0.02
_NEAR_EDGE_PX = 16
_RIGHT_WITHIN = 0.05
_SHARE_WITHIN = 0.10
_NAMES = ("scene", "mask", "learned_from", "regularize")
_PLANES = "calib"
# Spread over a video; the frames between are much like them.
_VIDEO_FRAMES = 4
_EPILOG = """examples:
  two scenes, with and without graph cuts, and whether the confidence can be trusted:
    coded_aperture bench accuracy scenes desk/ corridor/ --regularize none graphcut
  all masks that the scene was rendered with, results and figures into a folder:
    coded_aperture bench accuracy scenes desk/ --masks levin four_hole disk --output results/
a scene's folder has:
  meta.json (camera and masks), depth_0.1mm.png, aif_linear.png, coded_MASK_linear.png
  or, for a video, depth_NNN.png, aif_NNN.png, coded_MASK_NNN.png
where a folder calib/ in it or beside it has pictures of planes from the same camera, a bank that is
learned from these is measured too
"""


@dataclasses.dataclass(frozen=True)
class Cell:
    """One scene through one mask, and what the bank is learned from.

    `planes` is a folder of calibration planes, or None to learn from the camera.
    """

    folder: Path
    planes: Path | None
    mask: str
    regularize: str | None
    noise: float
    levels: int
    window_px: int | None
    seed: int


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a cell, for JSON, and the reliability of its confidence."""

    row: dict[str, Any]
    reliability: Any


def add_parser(subparsers: Any) -> None:
    """Add these frames to the parser of `bench accuracy`."""
    parser = subparsers.add_parser(
        "scenes",
        help="ray-traced scenes with true depth",
        description="Median relative error of the depth of ray-traced scenes, coverage, and "
        "how often the depth is right to 5 % where the confidence says so. The bank is learned "
        "from the camera, for the scene's range of depths.",
        epilog=_EPILOG,
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="a scene")
    parser.add_argument(
        "--masks",
        nargs="+",
        default=["levin"],
        metavar="MASK",
        help="that the scenes were rendered with (default levin)",
    )
    parser.add_argument(
        "--noise",
        type=noise_level,
        default=_NOISE,
        metavar="S",
        help=f"noise to add, linear light (default {_NOISE})",
    )
    parser.add_argument(
        "--levels",
        type=at_least(2),
        default=_LEVELS,
        metavar="N",
        help=f"blur levels of the bank (default {_LEVELS})",
    )
    parser.add_argument(
        "--regularize",
        nargs="+",
        default=[None],
        metavar="HOW",
        help="none, graphcut and so on (default, and what there is: see the command depth)",
    )
    parser.add_argument(
        "--window",
        type=at_least(16),
        metavar="PX",
        help="side of the bank's patches (default: as the command learn)",
    )
    parser.add_argument(
        "--seed", type=at_least(0), default=0, metavar="N", help="of the noise (default 0)"
    )
    add_result_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    check_result_options(args)
    for how in args.regularize:
        if how is not None and how not in bank_methods().values():
            args.usage_error(
                f"--regularize: unknown {how!r}, use some of {', '.join(bank_methods().values())}"
            )
    cells = [
        Cell(folder, planes, mask, how, args.noise, args.levels, args.window, args.seed)
        for folder, mask in itertools.product(args.folders, args.masks)
        for planes in (None, *_planes_of(folder, mask))
        for how in args.regularize
    ]
    start = time.perf_counter()
    measured = measure_cells(measure_cell, cells, args.jobs)
    rows = [cell.row for cell in measured]
    report(
        args,
        {
            "benchmark": "scenes",
            "noise": args.noise,
            "levels": args.levels,
            "seed": args.seed,
            "seconds": round(time.perf_counter() - start, 1),
            "cells": rows,
        },
        lambda: _tables(measured),
        lambda folder: _draw(measured, folder),
    )
    return 0


def _planes_of(folder: Path, mask: str) -> list[Path]:
    """Return the folder of calibration planes of the same camera in or beside a scene's."""
    from coded_aperture_benchmarks.ray_traced import scene_camera

    camera = scene_camera(folder, mask)
    for parent in (folder, folder.resolve().parent):
        planes = parent / _PLANES
        if (planes / "planes.json").is_file():
            try:
                same = scene_camera(planes, mask) == camera
            except InputError:
                same = False
            if same:
                return [planes]
    return []


def measure_cell(cell: Cell) -> Measured:
    """Measure one scene through one mask."""
    import numpy as np

    from coded_aperture_benchmarks import RayTracedScene
    from coded_aperture_ros.depth import DepthConfig, DepthEstimator
    from coded_aperture_ros.metrics import Reliability

    views = RayTracedScene.load_views(cell.folder, cell.mask, _VIDEO_FRAMES)
    truth = np.concatenate([view.depth_m for view in views])
    bank = _bank(cell, views[0].camera, float(np.nanmin(truth)), float(np.nanmax(truth)))
    config = DepthConfig()
    if cell.regularize is not None:
        config = dataclasses.replace(config, regularize=cell.regularize)
    threshold = config.confidence_threshold
    config = dataclasses.replace(config, confidence_threshold=0.0)
    # A bank that was learned from planes knows their depths, and not this camera.
    estimator = DepthEstimator(bank, config, None if cell.planes else views[0].camera)
    random = np.random.default_rng(cell.seed)
    estimates, seconds = [], []
    for view in views:
        noise = cell.noise * random.standard_normal(view.coded.shape, dtype=np.float32)
        start = time.perf_counter()
        estimates.append(estimator.estimate((view.coded + noise).astype(np.float32)))
        seconds.append(time.perf_counter() - start)
    # One above the other, to be scored as one picture; with a camera or planes there are depths.
    depth = np.concatenate([np.asarray(each.depth_m) for each in estimates])
    confident = np.concatenate(
        [np.asarray(each.where_confident(threshold).depth_m) for each in estimates]
    )
    confidence = np.concatenate([each.confidence for each in estimates])
    near_edge = np.concatenate([view.edge_distance_px() for view in views]) <= _NEAR_EDGE_PX

    known = np.isfinite(depth) & np.isfinite(truth)
    right = np.abs(depth[known] - truth[known]) <= _RIGHT_WITHIN * truth[known]
    reliability = Reliability.of(confidence[known], right)
    row = {
        "scene": cell.folder.resolve().name,
        "mask": cell.mask,
        "learned_from": "planes" if cell.planes else "camera",
        "regularize": config.regularize,
        "frames": len(views),
        "confident": _score(confident, truth, near_edge),
        "everywhere": _score(depth, truth, near_edge),
        "confidence_threshold": threshold,
        "expected_calibration_error": round(reliability.expected_calibration_error, 4),
        "reliability": reliability.rows(),
        "noise_estimated": round(float(np.mean([each.noise for each in estimates])), 6),
        "seconds": round(float(np.mean(seconds)), 3),
    }
    return Measured(row, reliability)


def _bank(cell: Cell, camera: Any, nearest_m: float, farthest_m: float) -> Any:
    from coded_aperture_ros.bank import LearnConfig, learn_bank_for_camera
    from coded_aperture_ros.calibration.planes.calibrate import learn_bank_from_planes
    from coded_aperture_ros.calibration.planes.folder import load_folder

    config = LearnConfig()
    if cell.window_px is not None:
        config = dataclasses.replace(config, window_px=cell.window_px)
    if cell.planes is not None:
        return learn_bank_from_planes(load_folder(cell.planes), cell.levels, config)
    nearest_m *= 1 - _RANGE_MARGIN
    farthest_m *= 1 + _RANGE_MARGIN
    return learn_bank_for_camera(camera, nearest_m, farthest_m, cell.levels, config)


def _score(depth_m: Any, truth: Any, near_edge: Any) -> dict[str, Any]:
    """Return median relative error, coverage and share within 10 %: all, near edges and away."""
    import numpy as np

    relative = np.abs(depth_m - truth) / truth
    has_truth = np.isfinite(truth)
    score = {}
    for name, part in (("all", has_truth), ("near_edges", near_edge), ("away", ~near_edge)):
        part = part & has_truth
        errors = relative[part & np.isfinite(relative)]
        score[name] = {
            "median_error": round(float(np.median(errors)), 4) if errors.size else None,
            "within_10_percent": (
                round(float(np.mean(errors <= _SHARE_WITHIN)), 4) if errors.size else None
            ),
            "coverage": round(errors.size / max(np.count_nonzero(part), 1), 4),
        }
    return score


def _tables(measured: Sequence[Measured]) -> str:
    first = measured[0].row
    parts = [
        "median relative error of depth / share of pixels within 10 % / coverage, in per cent; "
        f"edges: within {_NEAR_EDGE_PX} px"
    ]
    titles = {
        "confident": f"confidence at least {first['confidence_threshold']:g}",
        "everywhere": "every pixel",
    }
    for key, title in titles.items():
        lines = [
            [
                *(cell.row[name] for name in _NAMES),
                *(_score_text(cell.row[key][part]) for part in ("all", "near_edges", "away")),
                f"{cell.row['seconds']:.1f} s",
            ]
            for cell in measured
        ]
        header = [*_NAMES, "all", "near edges", "away", "time"]
        parts.append(f"{title}\n{table(header, lines)}")
    parts.append(
        f"confidence against share of pixels right to {100 * _RIGHT_WITHIN:g} %\n"
        + table(
            [*_NAMES, "calibration error", "confidence: share right"],
            [
                [
                    *(cell.row[name] for name in _NAMES),
                    f"{cell.row['expected_calibration_error']:.3f}",
                    " ".join(
                        f"{bin_['confidence']:.2f}:{bin_['share_right']:.2f}"
                        for bin_ in cell.row["reliability"]
                    ),
                ]
                for cell in measured
            ],
        )
    )
    return "\n\n".join(parts)


def _score_text(score: dict[str, Any]) -> str:
    if score["median_error"] is None:
        return f"- / - / {100 * score['coverage']:.0f}"
    return (
        f"{100 * score['median_error']:.1f} / {100 * score['within_10_percent']:.0f} / "
        f"{100 * score['coverage']:.0f}"
    )


def _draw(measured: Sequence[Measured], folder: Path) -> None:
    from coded_aperture_ros.metrics.figures import reliability_diagram

    curves = {", ".join(cell.row[name] for name in _NAMES): cell.reliability for cell in measured}
    reliability_diagram(
        curves, folder / "reliability.png", f"depth right to {100 * _RIGHT_WITHIN:g} %"
    )
