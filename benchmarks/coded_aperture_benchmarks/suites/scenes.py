"""`coded_aperture bench accuracy scenes`: metric depth of ray-traced scenes."""

import dataclasses
import itertools
import math
import time
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.dense import (
    DELTAS,
    NEAR_EDGE_PX,
    RIGHT_WITHIN,
    SHARE_WITHIN,
    TOLERANCES,
    WIDTHS,
    score,
)
from coded_aperture_benchmarks.frames.ray_traced import RayTracedScene, bank_for, scene_camera
from coded_aperture_benchmarks.identification import regularizations
from coded_aperture_benchmarks.rows import columns, mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.bank import FilterBank, LearnConfig
from coded_aperture_ros.calibration.planes.calibrate import learn_bank_from_planes
from coded_aperture_ros.calibration.planes.folder import load_folder
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.metrics import Reliability
from coded_aperture_ros.metrics.figures import reliability_diagram

_PLANES = "calib"
# Spread over a video; the frames between are much like them.
_VIDEO_FRAMES = 4
_NAMES = ("scene", "mask", "learned_from", "regularize")


class Scene(Protocol):
    """Where the views of a scene come from; goes to other processes, so it holds no pictures."""

    @property
    def name(self) -> str:
        """What the tables call it."""

    def views(self, mask: str) -> list[RayTracedScene]:
        """Return the frames with their truth, of one size and from one camera."""


@dataclasses.dataclass(frozen=True)
class FolderScene:
    """A scene on disk."""

    folder: Path

    @property
    def name(self) -> str:
        """The folder's."""
        return self.folder.resolve().name

    def views(self, mask: str) -> list[RayTracedScene]:
        """Read the still, or some frames of the video."""
        return RayTracedScene.load_views(self.folder, mask, _VIDEO_FRAMES)


@dataclasses.dataclass(frozen=True)
class Cell:
    """One scene through one mask, and what the bank is learned from.

    `planes` is a folder of calibration planes, or None to learn from the camera.
    """

    scene: Scene
    planes: Path | None
    mask: str
    config: DepthConfig
    noise: float
    levels: int
    window_px: int | None
    seed: int


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a cell, for JSON, and the reliability of its confidence."""

    row: Row
    reliability: Reliability


def _cells(args: options.Args) -> list[Cell]:
    options.check_known(args, "regularize", filter(None, args.regularize), regularizations())
    configs = [DepthConfig(regularize=how) if how else DepthConfig() for how in args.regularize]
    return [
        Cell(
            FolderScene(folder),
            planes,
            mask,
            config,
            args.noise,
            args.levels,
            args.window,
            args.seed,
        )
        for folder, mask in itertools.product(args.folders, args.masks)
        for planes in (None, *planes_of(folder, mask))
        for config in configs
    ]


def planes_of(folder: Path, mask: str) -> list[Path]:
    """Return the folder of calibration planes of the same camera in or beside a scene's."""
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


def measure(cell: Cell) -> Measured:
    """Measure one scene through one mask."""
    views = cell.scene.views(cell.mask)
    truth = np.concatenate([view.depth_m for view in views])
    threshold = cell.config.confidence_threshold
    estimator = DepthEstimator(
        _bank(cell, views[0], truth),
        dataclasses.replace(cell.config, confidence_threshold=0.0),
        # A bank that was learned from planes knows their depths, and not this camera.
        None if cell.planes else views[0].camera,
    )
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
    std_dev = np.concatenate([np.asarray(each.std_dev_m) for each in estimates])
    confidence = np.concatenate([each.confidence for each in estimates])
    near_edge = np.concatenate([view.edge_distance_px() for view in views]) <= NEAR_EDGE_PX

    known = np.isfinite(depth) & np.isfinite(truth)
    right = np.abs(depth[known] - truth[known]) <= RIGHT_WITHIN * truth[known]
    reliability = Reliability.of(confidence[known], right)
    frames = (len(views), -1, truth.shape[1])
    row = {
        "scene": cell.scene.name,
        "mask": cell.mask,
        "learned_from": "planes" if cell.planes else "camera",
        "regularize": cell.config.regularize,
        "frames": len(views),
        "confident": _score(confident, truth, near_edge),
        "everywhere": _score(depth, truth, near_edge),
        "confidence_threshold": threshold,
        "expected_calibration_error": round(reliability.expected_calibration_error, 4),
        "reliability": reliability.rows(),
        "dense": score(
            depth.reshape(frames),
            std_dev.reshape(frames),
            confidence.reshape(frames),
            truth.reshape(frames),
            views[0].camera,
            threshold,
        ),
        "noise_estimated": mean_of((each.noise for each in estimates), 6),
        "seconds": mean_of(seconds, 3),
    }
    return Measured(row, reliability)


def _bank(cell: Cell, view: RayTracedScene, depth_m: NDArray[np.float32]) -> FilterBank:
    config = LearnConfig()
    if cell.window_px is not None:
        config = dataclasses.replace(config, window_px=cell.window_px)
    if cell.planes is not None:
        return learn_bank_from_planes(load_folder(cell.planes), cell.levels, config)
    return bank_for(view.camera, depth_m, cell.levels, config)


def _score(
    depth_m: NDArray[np.float32], truth: NDArray[np.float32], near_edge: NDArray[np.bool_]
) -> dict[str, Row]:
    """Return median relative error, coverage and share within 10 %: all, near edges and away."""
    relative = np.abs(depth_m - truth) / truth
    has_truth = np.isfinite(truth)
    score = {}
    for name, part in (("all", has_truth), ("near_edges", near_edge), ("away", ~near_edge)):
        part = part & has_truth
        errors = relative[part & np.isfinite(relative)]
        within = errors <= SHARE_WITHIN
        score[name] = {
            "median_error": round(float(np.median(errors)), 4) if errors.size else None,
            "within_10_percent": round(float(np.mean(within)), 4) if errors.size else None,
            "coverage": round(errors.size / max(np.count_nonzero(part), 1), 4),
        }
    return score


def _results(args: options.Args, measured: list[Measured], seconds: float) -> Row:
    return {
        "benchmark": "scenes",
        **options.header(args, "noise", "levels", "seed"),
        "seconds": seconds,
        "cells": [cell.row for cell in measured],
    }


def _text(results: Row) -> str:
    rows = results["cells"]
    names = {name: f"{{{name}}}" for name in _NAMES}
    parts = [
        "median relative error of depth / share of pixels within 10 % / coverage, in per cent; "
        f"edges: within {NEAR_EDGE_PX} px"
    ]
    for key, title in (
        ("confident", f"confidence at least {rows[0]['confidence_threshold']:g}"),
        ("everywhere", "every pixel"),
    ):
        described = {
            **names,
            "all": lambda row, key=key: _score_text(row[key]["all"]),
            "near edges": lambda row, key=key: _score_text(row[key]["near_edges"]),
            "away": lambda row, key=key: _score_text(row[key]["away"]),
            "time": "{seconds:.1f} s",
        }
        parts.append(f"{title}\n{columns(rows, described)}")
    reliability = {
        **names,
        "calibration error": "{expected_calibration_error:.3f}",
        "confidence: share right": lambda row: " ".join(
            f"{bin_['confidence']:.2f}:{bin_['share_right']:.2f}" for bin_ in row["reliability"]
        ),
    }
    title = f"confidence against share of pixels right to {100 * RIGHT_WITHIN:g} %"
    parts.append(f"{title}\n{columns(rows, reliability)}")
    return "\n\n".join([*parts, *_dense_text(rows, names), _summary(rows, names)])


def _dense_text(rows: list[Row], names: dict[str, str]) -> list[str]:
    errors = {
        **names,
        **{
            f"{title} {part}": lambda row, key=key, form=form, of=of: _number(of(row)[key], form)
            for part, of in (("all", _dense), ("published", _published))
            for title, key, form in (
                ("AbsRel", "abs_rel", "{:.3f}"),
                *((name.replace("delta_", "d<"), name, "{:.3f}") for name in DELTAS),
            )
        },
        "AUSE": lambda row: _number(_dense(row)["sparsification"]["ause"], "{:.4f}"),
    }
    edges = {
        **names,
        **{
            f"F {px} px": lambda row, px=px: _per_cent(_dense(row)["boundary"][px]["f_score"])
            for px in TOLERANCES
        },
        **{
            f"{what} {width}": lambda row, what=what, width=width: _found(_dense(row)[what][width])
            for what in ("thin", "gaps")
            for width in WIDTHS
        },
    }
    return [
        "mean relative error (of pixels with depth), share of pixels off by less than a factor "
        "(no depth is wrong), area between sparsification curve and oracle's (relative error)\n"
        f"{columns(rows, errors)}",
        "F-score of depth edges in per cent, by tolerance; thin structures and gaps by width in "
        f"px: found / pieces\n{columns(rows, edges)}",
    ]


def _summary(rows: list[Row], names: dict[str, str]) -> str:
    described = {
        **names,
        "every pixel": lambda row: _per_cent(_dense(row)["within_10_percent"]),
        "published": lambda row: _per_cent(_published(row)["within_10_percent"]),
        "near edges": lambda row: _per_cent(_dense(row)["within_10_percent_near_edges"]),
        "away": lambda row: _per_cent(_dense(row)["within_10_percent_away"]),
        "median away": lambda row: _per_cent(_dense(row)["median_error_away"], 1),
        "confident": lambda row: _per_cent(_dense(row)["confident"]["within_10_percent"]),
        "coverage": lambda row: _per_cent(_dense(row)["confident"]["coverage"]),
        "calibration error": "{expected_calibration_error:.3f}",
        "within one std dev": lambda row: _per_cent(_dense(row)["std_dev"]["within_one"]),
    }
    worst_first = sorted(rows, key=lambda row: _order(_dense(row)["within_10_percent"]))
    return (
        f"in short, worst first: per cent of all pixels within {100 * SHARE_WITHIN:g} % (no depth "
        "is wrong), median error; confident pixels within "
        f"{100 * SHARE_WITHIN:g} %, their coverage; published pixels within the stated standard "
        f"deviation\n{columns(worst_first, described)}"
    )


def _dense(row: Row) -> Row:
    dense: Row = row["dense"]
    return dense


def _published(row: Row) -> Row:
    published: Row = row["dense"]["published"]
    return published


def _order(share: float) -> float:
    """Return what puts a scene with nothing to score first."""
    return share if math.isfinite(share) else -1.0


def _per_cent(share: float, digits: int = 0) -> str:
    return f"{100 * share:.{digits}f}" if math.isfinite(share) else "-"


def _number(value: float, form: str) -> str:
    return form.format(value) if math.isfinite(value) else "-"


def _found(pieces: Row) -> str:
    return f"{pieces['found']}/{pieces['pieces']}"


def _score_text(score: Row) -> str:
    coverage = f"{100 * score['coverage']:.0f}"
    if score["median_error"] is None:
        return f"- / - / {coverage}"
    error, share = (100 * score[name] for name in ("median_error", "within_10_percent"))
    return f"{error:.1f} / {share:.0f} / {coverage}"


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    curves = {", ".join(cell.row[name] for name in _NAMES): cell.reliability for cell in measured}
    title = f"depth right to {100 * RIGHT_WITHIN:g} %"
    reliability_diagram(curves, folder / "reliability.png", title)


SUITE = Suite(
    description="Median relative error of the depth of ray-traced scenes, coverage, the field's "
    "dense errors, depth edges, thin structures, and how often the depth is right to 5 % where the "
    "confidence says so. The bank is learned from the camera, for the scene's range of depths.",
    examples="""examples:
  two scenes, with and without graph cuts, and whether the confidence can be trusted:
    coded_aperture bench accuracy scenes desk/ corridor/ --regularize none graphcut
  all masks that the scene was rendered with, results and figures into a folder:
    coded_aperture bench accuracy scenes desk/ --masks levin four_hole disk --output results/
a scene's folder has:
  meta.json (camera and masks), depth_0.1mm.png, aif_linear.png, coded_MASK_linear.png
  and, where not every depth is reliable, valid.png (255: it is);
  or, for a video, depth_NNN.png, aif_NNN.png, coded_MASK_NNN.png
where a folder calib/ in it or beside it has pictures of planes from the same camera, a bank that is
learned from these is measured too
""",
    options=(
        options.folders("a scene"),
        options.SCENE_MASKS,
        options.added_noise(0.002),
        options.number("--levels", 2, 30, "blur levels of the bank"),
        options.REGULARIZE,
        options.WINDOW_AS_LEARN,
        options.NOISE_SEED,
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
