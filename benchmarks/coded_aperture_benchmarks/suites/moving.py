"""Depth of a camera that walks through rooms, with and without what past frames tell."""

import argparse
import dataclasses
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.room import Room, box_boards, random_room, walk
from coded_aperture_benchmarks.datasets.walks import WALKING_RANGE_M, walking_camera
from coded_aperture_benchmarks.methods.depth import CameraBank
from coded_aperture_benchmarks.metrics.flicker import Deblurring, Flicker, Seen
from coded_aperture_benchmarks.pictures import as_rgb, of_width, side_by_side
from coded_aperture_benchmarks.rows import grouped, mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.depth import DepthConfig, DepthEstimate, DepthEstimator
from coded_aperture_ros.depth.moving import Pinhole
from coded_aperture_ros.frames import SRGB, Frame
from coded_aperture_ros.io import depth_picture, write_image
from coded_aperture_ros.optics import MASK_NAMES, Camera, Mask
from coded_aperture_ros.simulation import SensorModel

# A walk begins at rest: frames before this have hardly any parallax.
_FIRST, _WARM_UP = 14, 4
# What is told of the motion, and what the rows call it.
SINGLE, MEMORY, FRAMES, POSE, DRIFTING = "single", "memory", "frames", "pose", "drifting pose"
_TITLES = {
    SINGLE: "every frame for itself",
    MEMORY: "temporal.frames, nothing told of the motion",
    FRAMES: "moving_camera: frames",
    POSE: "moving_camera: pose",
    DRIFTING: "the same, a pose that drifts by 1 %",
}
_TRUTH, _WIDTH_PX = "truth", 1600
_DRAWN = (_TRUTH, SINGLE, FRAMES, POSE)
_DRIFT, _RIGHT, _EDGE_PX, _AROUND_PX = 0.01, 0.1, 12, 24
_MOST_ERROR = 10.0
# All-in-focus frames are made for at least this noise.
_LEAST_NOISE = 5e-4
# What moves by itself: a box, so large, before the middle of the way, so far at a step, m.
_BOX_M, _BOX_AT_M, _BOX_STEP_M = (0.35, 0.9, 0.3), (-0.6, 0.0, 2.0), (0.04, 0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class Cell:
    """A walk through a room made by chance."""

    room: int
    frames: int
    step_m: float
    memory: float
    noise: float
    mask: str
    mover: bool


@dataclasses.dataclass(frozen=True, eq=False)
class _View:
    """One frame, its true depth, and which pixels show what moves by itself."""

    pose: DoubleArray
    coded: FloatArray
    depth_m: FloatArray
    moving: BoolArray


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """Rows of a walk, its last frame, and the depth of that: true, and in every way."""

    rows: list[Row]
    coded: FloatArray
    depths_m: dict[str, FloatArray]


def _cells(args: argparse.Namespace) -> list[Cell]:
    options.check_known(args, "mask", [args.mask], MASK_NAMES)
    how = args.frames, args.step, args.memory, args.noise, args.mask, args.mover
    return [Cell(args.first_room + index, *how) for index in range(args.rooms)]


def measure(cell: Cell) -> Measured:
    """Walk once, and estimate the depth of its frames in every way."""
    camera = walking_camera(Mask.named(cell.mask))
    views = list(_views(cell, camera))
    bank = CameraBank.guarded(camera, WALKING_RANGE_M, 30).learn()
    poses = np.stack([view.pose for view in views])
    rows, depths_m = [], {_TRUTH: views[-1].depth_m}
    deblurring = Deblurring(bank.stack, max(cell.noise, _LEAST_NOISE))
    pinhole = Pinhole.of_map(camera, views[0].coded.shape)
    clear = [deblurring.by_truth(camera, view.coded, view.depth_m) for view in views]
    seen = [Seen(view.pose, view.depth_m, sharp) for view, sharp in zip(views, clear, strict=True)]
    for name in _TITLES:
        config = _config(name, cell.memory)
        estimator = DepthEstimator(bank, config, camera)
        given = _drifting(poses, cell.room) if name == DRIFTING else poses
        takes = config.moving_camera == POSE
        scores, seconds, flicker = [], [], Flicker(deblurring, pinhole)
        for index, view in enumerate(views):
            frame = Frame(view.coded, pose=partial(given.__getitem__, index) if takes else None)
            estimate = estimator.estimate(frame)
            seconds.append(estimate.seconds.get("moving camera", 0.0))
            flicker.add(view.coded, seen[index], estimate)
            if index >= _WARM_UP:
                scores.append(_score(estimate, view))
        estimator.close()
        depths_m[name] = np.asarray(estimate.depth_m)
        keys = scores[0].keys()
        row = {key: _mean_known(score[key] for score in scores) for key in keys}
        ms = round(1e3 * float(np.median(seconds)), 2)
        row |= flicker.result(_WARM_UP)
        rows.append({"room": cell.room, "told": name, **row, "stage_ms": ms})
    deblurring.close()
    return Measured(rows, views[-1].coded, depths_m)


def _config(name: str, memory: float) -> DepthConfig:
    """How depth is estimated; every pixel is scored, none left out for lack of confidence."""
    moving = {FRAMES: "frames", POSE: "pose", DRIFTING: "pose"}.get(name, "")
    frames = 0.0 if name == SINGLE else memory
    return DepthConfig(confidence_threshold=0.0, temporal_frames=frames, moving_camera=moving)


def _views(cell: Cell, camera: Camera) -> Iterator[_View]:
    """Frames of a walk, with noise."""
    length_m = cell.step_m * (cell.frames + 2 * _FIRST)
    poses = walk(cell.room, length_m, cell.step_m)[_FIRST : _FIRST + cell.frames]
    room, random = random_room(cell.room), np.random.default_rng([cell.room, 5])
    sensor = SensorModel(cell.noise)
    for index, pose in enumerate(poses):
        shown = _with_box(room, poses, index) if cell.mover else room
        _, depth_m = shown.seen(camera, pose)
        without_m = room.seen(camera, pose)[1] if cell.mover else depth_m
        coded = sensor.expose(shown.coded(camera, pose), random)
        yield _View(pose, np.clip(coded, 0, 1), depth_m, np.abs(without_m - depth_m) > 1e-3)


def _with_box(room: Room, poses: DoubleArray, index: int) -> Room:
    """Room with a box that goes by before the middle of the way."""
    middle = poses[len(poses) // 2]
    shift = np.array(_BOX_AT_M) + np.array(_BOX_STEP_M) * (index - len(poses) // 2)
    place = middle[:3, :3] @ shift + middle[:3, 3]
    random = np.random.default_rng(99)  # the same box in all frames
    return Room((*box_boards(random, place, _BOX_M, 0.4), *room.boards))


def _drifting(poses: DoubleArray, seed: int) -> DoubleArray:
    """Poses whose steps are each off by a share of their length, in length and direction."""
    random, found = np.random.default_rng([13, seed]), [poses[0]]
    for before, after in pairwise(poses):
        step = np.linalg.inv(before) @ after
        length_m = np.linalg.norm(step[:3, 3])
        step[:3, 3] *= 1 + _DRIFT * random.normal()
        step[:3, 3] += _DRIFT * length_m * random.normal(size=3)
        found.append(found[-1] @ step)
    return np.stack(found)


def _score(estimate: DepthEstimate, view: _View) -> Row:
    """How far the depth of a frame is off, everywhere and in parts."""
    assert estimate.depth_m is not None
    known = np.isfinite(view.depth_m)
    error = np.abs(estimate.depth_m / view.depth_m - 1)
    error = np.minimum(np.where(np.isfinite(error), error, _MOST_ERROR), _MOST_ERROR)
    edge = known & _near_edges(view.depth_m)
    published = known & (estimate.confidence >= DepthConfig().confidence_threshold)
    around = _grown(view.moving, _AROUND_PX) & ~view.moving & known
    sure = estimate.confidence[published]
    return {
        "mean": _mean(error[known]),
        "right": _mean(error[known] < _RIGHT),
        "edges": _mean(error[edge]),
        "published": float(published.sum() / known.sum()),
        "published_right": float((published & (error < _RIGHT)).sum() / known.sum()),
        "confidence": _mean(sure),
        "within_5": _mean(error[published] < 0.05),
        "moving": _mean(error[view.moving & known]),
        "around_moving": _mean(error[around]),
    }


def _mean(values: NDArray) -> float | None:
    return float(values.mean()) if values.size else None


def _mean_known(values: Iterable[float | None]) -> float | None:
    """Mean of what there is, rounded; None without any."""
    known = [value for value in values if value is not None]
    return mean_of(known, 4) if known else None


def _near_edges(depth_m: FloatArray) -> BoolArray:
    """Pixels near steps of depth of more than 5 % from one pixel to the next."""
    logarithm = np.log(depth_m)
    steps = np.zeros(depth_m.shape, np.bool_)
    steps[:, 1:] |= np.abs(np.diff(logarithm, axis=1)) > 0.05
    steps[1:] |= np.abs(np.diff(logarithm, axis=0)) > 0.05
    return _grown(steps, _EDGE_PX)


def _grown(where: BoolArray, by_px: int) -> BoolArray:
    square = np.ones((2 * by_px + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(where.astype(np.uint8), square) > 0)


def _results(_: argparse.Namespace, measured: list[Measured]) -> Row:
    rows = [row for each in measured for row in each.rows]
    shown = [key for key in rows[0] if key not in ("room", "told")]
    pooled = [
        {"told": told, **{key: _mean_known(row[key] for row in group) for key in shown}}
        for (told,), group in grouped(rows, "told").items()
    ]
    return {"rows": rows, "pooled": pooled}


def _percent(key: str, row: Row) -> str:
    return "-" if row[key] is None else f"{100 * row[key]:.1f} %"


def _text(results: Row) -> str:
    percent = {
        "mean error": "mean",
        "near edges": "edges",
        "within 10 %": "right",
        "published": "published",
        "and within 10 %": "published_right",
        "within 5 %": "within_5",
        "confidence": "confidence",
        "depth flickers": "depth_flicker",
        "light / noise": "light_flicker",
    }
    if results["mover"]:
        percent |= {"what moves": "moving", "around it": "around_moving"}
    shown: dict[str, str | Callable[[Row], str]] = {
        title: partial(_percent, key) for title, key in percent.items()
    }
    shown["stage, ms"] = "{stage_ms:.1f}"
    parts = [
        f"walks of {results['frames']} frames in steps of {100 * results['step']:g} cm, memory "
        f"{results['memory']:g} frames, noise {results['noise']:g}, mask {results['mask']}; the "
        f"first {_WARM_UP} frames do not count"
    ]
    tables = [(f"room {room}", rows) for (room,), rows in grouped(results["rows"], "room").items()]
    for title, rows in [*tables, ("mean", results["pooled"])]:
        named = {title: lambda row: _TITLES[row["told"]]}
        parts.append(columns(rows, named | shown))
    return "\n\n".join(parts)


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    for each in measured:
        panels = [("coded", [as_rgb(each.coded, SRGB)])] + [
            (name, [depth_picture(depth_m, *WALKING_RANGE_M)[: depth_m.shape[0]]])
            for name, depth_m in each.depths_m.items()
            if name in _DRAWN
        ]
        room = each.rows[0]["room"]
        write_image(folder / f"room_{room}.jpg", of_width(side_by_side(panels), _WIDTH_PX))


SUITE = Suite(
    name="moving",
    said=("frames", "step", "memory", "noise", "mask", "mover"),
    description="Walk with a coded camera through random furnished rooms, and estimate depth with "
    "and without what past frames tell: nothing known of the motion, motion found in the frames, "
    "the true pose, and a pose that drifts. Rays are traced through every opening of the mask.",
    examples="""examples:
  ten walks (a quarter of an hour on two cores):
    python -m coded_aperture_benchmarks moving --rooms 10
  two with a box that goes by:
    python -m coded_aperture_benchmarks moving --rooms 2 --mover
""",
    options=(
        options.number("--rooms", 1, 10, "that are walked through"),
        options.number("--first-room", 0, 60, "the number of the first", "N"),
        options.number("--frames", 7, 24, "of a walk"),
        options.option("--step", "from frame to frame, m", 0.05, type=float, metavar="M"),
        options.option("--memory", "temporal frames", 8.0, type=float, metavar="FRAMES"),
        options.option("--mover", "let a box go by before the camera", action="store_true"),
        options.added_noise(0.002),
        options.option("--mask", "of the camera", "levin", metavar="MASK"),
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
