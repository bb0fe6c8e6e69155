"""Metric depth of ray-traced scenes."""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.random_scenes import FIRST_SEED, RandomScene
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene, Rods, scene_camera
from coded_aperture_benchmarks.datasets.recording import recording
from coded_aperture_benchmarks.methods.depth import Bank, CameraBank, predictor
from coded_aperture_benchmarks.methods.identification import regularizations
from coded_aperture_benchmarks.metrics.dense import (
    NEAR_EDGE_PX,
    RIGHT_WITHIN,
    SHARE_WITHIN,
    score,
    score_rods,
)
from coded_aperture_benchmarks.pictures import frames_and_depths
from coded_aperture_benchmarks.rows import mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.suites.scenes_tables import NAMES, order, text_of
from coded_aperture_ros.calibration.planes.calibrate import learn_bank_from_planes
from coded_aperture_ros.calibration.planes.folder import load_folder
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.io import write_image
from coded_aperture_ros.likelihood.bank import FilterBank, LearnConfig
from coded_aperture_ros.metrics import Reliability
from coded_aperture_ros.metrics.figures import reliability_diagram
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.simulation.layered import SIDES

_PLANES = "calib"
# Spread over a video; the frames between are much like them.
_VIDEO_FRAMES = 4
# Of the random scenes of a kind, so many have rows of their own in the tables.
_WORST = 10


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


@dataclasses.dataclass(frozen=True)
class PlanesBank:
    """A bank for pictures of planes in a folder."""

    folder: Path
    levels: int
    config: LearnConfig

    def learn(self) -> FilterBank:
        """Return the bank."""
        return learn_bank_from_planes(load_folder(self.folder), self.levels, self.config)


@dataclasses.dataclass(frozen=True, eq=False)
class Maps:
    """What was estimated of some frames, one above the other, and the truth.

    Attributes
    ----------
    coded : ndarray, float32 [frames, rows, columns(, 3)]
        What was given, with its noise.
    depth_m, published_m, std_dev_m, confidence, truth_m : ndarray, float32 [frames, rows, columns]
        Published is what is confident.
    near_edge : ndarray of bool, of the same shape
    cameras : list of Camera
        Of each frame.
    rods : list of Rods
        Of each frame, or empty.
    noise, seconds : list of float
        Estimated noise of each frame, and how long it took.
    """

    coded: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    published_m: NDArray[np.float32]
    std_dev_m: NDArray[np.float32]
    confidence: NDArray[np.float32]
    truth_m: NDArray[np.float32]
    near_edge: NDArray[np.bool_]
    cameras: list[Camera]
    rods: list[Rods]
    noise: list[float]
    seconds: list[float]

    @staticmethod
    def together(parts: "Sequence[Maps]") -> "Maps":
        """Return the frames of all parts."""
        joined: dict[str, Any] = {}
        for field in dataclasses.fields(Maps):
            values = [getattr(part, field.name) for part in parts]
            lists = isinstance(values[0], list)
            join = itertools.chain.from_iterable if lists else np.concatenate
            joined[field.name] = list(join(values)) if lists else join(values)
        return Maps(**joined)

    def reliability(self) -> Reliability:
        """Return how often the confidence was right."""
        known = np.isfinite(self.depth_m) & np.isfinite(self.truth_m)
        truth = self.truth_m[known]
        right = np.abs(self.depth_m[known] - truth) <= RIGHT_WITHIN * truth
        return Reliability.from_estimates(self.confidence[known], right)


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a cell, for JSON, and the reliability of its confidence.

    `maps` is None unless the cell's scene is pooled with others, `picture` where it is.
    """

    cell: Cell
    row: Row
    reliability: Reliability
    maps: Maps | None = None
    picture: NDArray[np.uint8] | None = None


def _cells(args: options.Args) -> list[Cell]:
    options.check_known(args, "regularize", filter(None, args.regularize), regularizations())
    if not args.folders and not args.random:
        args.usage_error("expected at least one FOLDER, or --random N")
    if args.random:
        options.check_masks(args)
    configs = [DepthConfig(regularize=how) if how else DepthConfig() for how in args.regularize]
    scenes: list[Scene] = [FolderScene(folder) for folder in args.folders]
    scenes += [
        RandomScene(args.first_seed + number, args.side, args.size, args.rods)
        for number in range(args.random)
    ]
    return [
        Cell(scene, planes, mask, config, args.noise, args.levels, args.window, args.seed)
        for scene, mask in itertools.product(scenes, args.masks)
        for planes in (
            None,
            *(planes_of(scene.folder, mask) if isinstance(scene, FolderScene) else ()),
        )
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
    maps = _estimated(cell)
    row = _row(cell, cell.scene.name, maps)
    if isinstance(cell.scene, RandomScene):
        return Measured(cell, row, maps.reliability(), maps=maps)
    return Measured(cell, row, maps.reliability(), picture=_picture(maps))


def _picture(maps: Maps) -> NDArray[np.uint8]:
    """Draw the first frame and its depth: true, found, and what is confident of it."""
    depths_m = {
        "true": maps.truth_m[0],
        "every pixel": maps.depth_m[0],
        "published": maps.published_m[0],
    }
    ends_m = float(np.nanmin(maps.truth_m[0])), float(np.nanmax(maps.truth_m[0]))
    return frames_and_depths({"coded": maps.coded[0]}, depths_m, ends_m)


def _estimated(cell: Cell) -> Maps:
    views = cell.scene.views(cell.mask)
    truth = np.stack([view.depth_m for view in views])
    bank = _bank(cell, views[0], truth)
    config = dataclasses.replace(cell.config, confidence_threshold=0.0)
    # A bank that was learned from planes knows their depths, and not this camera.
    camera = None if cell.planes else views[0].camera
    random = np.random.default_rng(cell.seed)
    estimates, coded = [], []
    with predictor(bank, config, camera) as predict:
        for view in views:
            noise = cell.noise * random.standard_normal(view.coded.shape, dtype=np.float32)
            coded.append((view.coded + noise).astype(np.float32))
            estimates.append(predict(coded[-1]))
    threshold = cell.config.confidence_threshold
    # With a camera or planes there are depths.
    return Maps(
        np.stack(coded),
        np.stack([np.asarray(each.depth_m) for each in estimates]),
        np.stack([np.asarray(each.where_confident(threshold).depth_m) for each in estimates]),
        np.stack([np.asarray(each.std_dev_m) for each in estimates]),
        np.stack([each.confidence for each in estimates]),
        truth,
        np.stack([view.edge_distance_px() for view in views]) <= NEAR_EDGE_PX,
        [view.camera for view in views],
        [view.rods for view in views if view.rods is not None],
        [each.noise for each in estimates],
        [sum(each.seconds.values()) for each in estimates],
    )


def _row(cell: Cell, name: str, maps: Maps) -> Row:
    depth, truth = maps.depth_m, maps.truth_m
    threshold = cell.config.confidence_threshold
    reliability = maps.reliability()
    row: Row = {
        "scene": name,
        "mask": cell.mask,
        "learned_from": "planes" if cell.planes else "camera",
        "regularize": cell.config.regularize,
        "frames": len(depth),
        "confident": _score(maps.published_m, truth, maps.near_edge),
        "everywhere": _score(depth, truth, maps.near_edge),
        "confidence_threshold": threshold,
        "expected_calibration_error": round(reliability.expected_calibration_error, 4),
        "reliability": reliability.rows(),
        "dense": score(depth, maps.std_dev_m, maps.confidence, truth, maps.cameras, threshold),
        "noise_estimated": mean_of(maps.noise, 6),
        "seconds": mean_of(maps.seconds, 3),
    }
    if isinstance(cell.scene, FolderScene):
        near_m, far_m = float(np.nanmin(truth)), float(np.nanmax(truth))
        found = recording(maps.cameras[0], near_m, far_m)
        row["recording"] = found and {"camera": found.camera_text, "range": found.range_text}
    if maps.rods:
        row["rods"] = score_rods(list(np.abs(depth - truth) / truth), maps.rods)
    return row


def _pools(measured: list[Measured]) -> dict[tuple[str, ...], list[Measured]]:
    """Return the random scenes that go together: of one kind, mask and regularisation."""
    pools: dict[tuple[str, ...], list[Measured]] = {}
    for each in measured:
        if isinstance(each.cell.scene, RandomScene):
            row = each.row
            kind = each.cell.scene.kind, row["mask"], row["regularize"]
            pools.setdefault(kind, []).append(each)
    return pools


def _pooled(measured: list[Measured]) -> list[Row]:
    """Return a row for all frames of each pool together, then those of its worst scenes."""
    rows = []
    for (kind, *_), pool in _pools(measured).items():
        maps = Maps.together([each.maps for each in pool if each.maps is not None])
        rows.append(_row(pool[0].cell, f"{len(pool)} {kind}", maps))
        ranked = sorted(pool, key=lambda each: order(each.row["dense"]["within_10_percent"]))
        rows += [each.row for each in ranked[:_WORST]]
    return rows


def _bank(cell: Cell, view: RayTracedScene, depth_m: NDArray[np.float32]) -> Bank:
    config = LearnConfig()
    if cell.window_px is not None:
        config = dataclasses.replace(config, window_px=cell.window_px)
    if cell.planes is not None:
        return PlanesBank(cell.planes, cell.levels, config)
    return CameraBank.of_scene(view.camera, depth_m, cell.levels, config)


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


def _results(args: options.Args, measured: list[Measured]) -> Row:
    shown = [each.row for each in measured if isinstance(each.cell.scene, FolderScene)]
    return {
        "cells": [cell.row for cell in measured],
        # Not every random scene: those of a kind together, and the worst of them.
        "shown": shown + _pooled(measured),
    }


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    curves = {
        ", ".join(each.row[name] for name in NAMES): each.reliability
        for each in measured
        if each.maps is None
    }
    for kind, pool in _pools(measured).items():
        maps = Maps.together([each.maps for each in pool if each.maps is not None])
        curves[f"{len(pool)} {', '.join(kind)}"] = maps.reliability()
    title = f"depth right to {100 * RIGHT_WITHIN:g} %"
    reliability_diagram(curves, folder / "reliability.png", title)
    for each in measured:
        if each.picture is not None:
            name = "_".join(each.row[name] for name in NAMES)
            write_image(folder / f"{name}.jpg", each.picture)


SUITE = Suite(
    name="scenes",
    said=("noise", "levels", "seed"),
    description="Median relative error of the depth of ray-traced or random scenes, coverage, the "
    "field's dense errors, depth edges, thin structures, and how often the depth is right to 5 % "
    "where the confidence says so. The bank is learned from the camera, for the scene's range of "
    "depths.",
    examples="""examples:
  two scenes, with and without graph cuts, and whether the confidence can be trusted:
    coded_aperture bench accuracy scenes desk/ corridor/ --regularize none graphcut
  all masks that the scene was rendered with, results and figures into a folder:
    coded_aperture bench accuracy scenes desk/ --masks levin four_hole disk --output results/
  50 random scenes, all pixels together and the ten worst; 25 more with rods of known widths:
    coded_aperture bench accuracy scenes --random 50 --jobs 2
    coded_aperture bench accuracy scenes --random 25 --rods
a scene's folder has:
  meta.json (camera and masks), depth_0.1mm.png, aif_linear.png, coded_MASK_linear.png
  and, where not every depth is reliable, valid.png (255: it is);
  or, for a video, depth_NNN.png, aif_NNN.png, coded_MASK_NNN.png
where a folder calib/ in it or beside it has pictures of planes from the same camera, a bank that is
learned from these is measured too
""",
    options=(
        options.folders("a scene", "*"),
        options.number("--random", 0, 0, "random scenes instead of folders, or beside them"),
        options.option("--side", "of the focal plane, of random scenes", "far", choices=SIDES),
        options.number("--first-seed", 0, FIRST_SEED, "of the random scenes", "S"),
        options.option("--rods", "rods of known widths in random scenes", action="store_true"),
        options.frame_size(360, 480, "random scenes"),
        options.SCENE_MASKS,
        options.added_noise(0.002),
        options.number("--levels", 2, 30, "blur levels of the bank"),
        options.REGULARIZE,
        options.WINDOW_AS_LEARN,
        options.NOISE_SEED,
        *options.DEPTH_RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=text_of,
    draw=_draw,
)
