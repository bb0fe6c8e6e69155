"""How far a robot drifts that has nothing but these frames."""

import argparse
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.video import check_rgbd_video
from coded_aperture_benchmarks.datasets.walks import Walk, of_video, through_room
from coded_aperture_benchmarks.figures import seen_from_above
from coded_aperture_benchmarks.methods.depth import CameraBank
from coded_aperture_benchmarks.metrics.trajectories import Tracker, tracked, write_tum
from coded_aperture_benchmarks.pictures import as_rgb, of_width, side_by_side
from coded_aperture_benchmarks.rows import grouped, mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.depth.moving import Step, Trajectory
from coded_aperture_ros.depth.stages.temporal import VIDEO_FRAMES
from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import depth_picture, write_image
from coded_aperture_ros.optics import MASK_NAMES, Mask
from coded_aperture_ros.simulation import SensorModel

# Drift is told over ways of this length, wherever they begin.
_SEGMENT_M = 1.0
_SHOWN, _WIDTH_PX = 4, 1600
# What odometry is given, and what it is called.
TRUE, SAME_PIXELS, OURS, ALL, CODED = "true", "true, same pixels", "ours", "ours, all", "coded"
FOLLOWED = "followed"
_TITLES = {
    TRUE: "sharp frame, true depth",
    SAME_PIXELS: "sharp frame, true depth where ours is known",
    OURS: "all-in-focus frame, depth as published",
    ALL: "all-in-focus frame, depth of every pixel",
    CODED: "coded frame, depth as published",
}
# Without Open3D: what the estimate itself tells of the motion.
_ALL_TITLES = {**_TITLES, FOLLOWED: "nothing else: moving_camera: frames"}


@dataclasses.dataclass(frozen=True)
class Cell:
    """A walk through a room made by chance, or that of a video."""

    room: int
    length_m: float
    step_m: float
    noise: float
    mask: str
    video: Path | None = None

    @property
    def name(self) -> str:
        """What the tables call it."""
        return f"room {self.room}" if self.video is None else self.video.resolve().name

    def walk(self) -> Walk:
        """Begin the walk."""
        if self.video is not None:
            return of_video(self.video, self.mask)
        return through_room(self.room, self.length_m, self.step_m, Mask.named(self.mask))


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """A row for everything that odometry was given, the ways that it found, and some frames."""

    cell: Cell
    rows: list[Row]
    poses: dict[str, DoubleArray]
    shown: list[Any]
    range_m: tuple[float, float]


def _cells(args: argparse.Namespace) -> list[Cell]:
    if not 0 < args.step < args.length:
        args.usage_error("--step: expected less than --length")
    options.check_known(args, "mask", [args.mask], MASK_NAMES)
    Tracker.check()
    for folder in args.folders:
        check_rgbd_video(folder)
    rooms = range(args.first_room, args.first_room + args.rooms)
    how = args.length, args.step, args.noise, args.mask
    videos = [Cell(0, *how, folder) for folder in args.folders]
    return videos or [Cell(room, *how) for room in rooms]


def measure(cell: Cell) -> Measured:
    """Walk, and follow the way by everything that odometry may be given."""
    walk = cell.walk()
    trackers = {name: Tracker(walk.camera) for name in _TITLES}
    shown, errors, known, way, followed = [], [], [], Trajectory(), []
    every = -(-walk.count // _SHOWN)
    for index, (frames, step) in enumerate(_frames(cell, walk)):
        sharp, true_m, coded, clear, depth_m, every_m = frames
        way.add(step)
        followed.append(way.pose)
        published = np.isfinite(depth_m)
        given = {
            TRUE: (sharp, true_m),
            SAME_PIXELS: (sharp, np.where(published, true_m, np.nan)),
            OURS: (clear, depth_m),
            ALL: (clear, every_m),
            CODED: (coded, depth_m),
        }
        for name, (frame, depth) in given.items():
            trackers[name].add(frame, depth)
        off = np.abs(depth_m / true_m - 1)[published & np.isfinite(true_m)]
        if off.size:
            errors.append(float(np.median(off)))
        known.append(float(published.mean()))
        if index % every == 0:
            shown.append((sharp, coded, clear, true_m, every_m))
    poses = {name: tracker.poses() for name, tracker in trackers.items()}
    poses[FOLLOWED] = np.stack(followed)
    # Of a video nothing tells the way but odometry with its own depth.
    true = poses.pop(TRUE) if walk.poses is None else walk.poses
    of_depth = {"depth_error": mean_of(errors, 4), "known": mean_of(known, 3)}
    rows = [
        {"walk": cell.name, "given": name, "frames": len(true)}
        | tracked(true, found, _SEGMENT_M)
        | (of_depth if name == OURS else {})
        | ({"lost": way.lost} if name == FOLLOWED else {})
        for name, found in poses.items()
    ]
    return Measured(cell, rows, {"truth": true} | poses, shown, walk.range_m)


def _frames(cell: Cell, walk: Walk) -> Iterator[tuple[tuple[FloatArray, ...], Step]]:
    """Yield of every pose what odometry is given, and what the estimate tells of the motion.

    That is the sharp frame, true depth, coded and all-in-focus frame, and depths.
    """
    camera, random = walk.camera, np.random.default_rng(cell.room)
    sensor = SensorModel(cell.noise)
    bank = CameraBank.guarded(camera, walk.range_m, 30).learn()
    config = DepthConfig(temporal_frames=VIDEO_FRAMES, confidence_threshold=0.0)
    estimator = DepthEstimator(bank, config, camera)
    following = DepthEstimator(bank, dataclasses.replace(config, moving_camera="frames"), camera)
    deblurrer = Deblurrer(bank.stack, DeblurConfig(method="fast"))
    threshold = DepthConfig().confidence_threshold
    for light, true_m, coded_light in walk.views:
        sharp, coded = (np.clip(sensor.expose(each, random), 0, 1) for each in (light, coded_light))
        estimate = estimator.estimate(coded)
        published = estimate.where_confident(threshold)
        clear = deblurrer.deblur(coded, published.blur_size_px)
        depths = np.asarray(published.depth_m), np.asarray(estimate.depth_m)
        step = following.estimate(coded).camera_step
        assert step is not None  # `moving_camera` is set
        yield (sharp, true_m, coded, clear, *depths), step
    estimator.close()
    following.close()
    deblurrer.close()


def _results(args: argparse.Namespace, measured: list[Measured]) -> Row:
    rows = [row for each in measured for row in each.rows]
    return {
        "videos": [str(folder) for folder in args.folders],
        "rows": rows,
        "pooled": [
            {
                "given": given,
                **{
                    key: mean_of((row[key] for row in group), 4)
                    for key in ("drift_per_m", "turn_per_m_deg", "scale", "end_per_m")
                },
            }
            for (given,), group in grouped(rows, "given").items()
        ],
    }


def _text(results: Row) -> str:
    shown = {
        "odometry is given": lambda row: _ALL_TITLES[row["given"]],
        "drift": lambda row: f"{100 * row['drift_per_m']:.1f} %",
        "turned, degrees a metre": "{turn_per_m_deg:.2f}",
        "length of a step": "{scale:.3f}",
        "off at the end, of the way": lambda row: f"{100 * row['end_per_m']:.1f} %",
    }
    way = f"walks of {results['length']:g} m in steps of {100 * results['step']:g} cm"
    if results["videos"]:
        way = "videos, against the way found with their own depth"
    parts = [
        f"{way}, noise {results['noise']:g}, mask {results['mask']}; length of a step: found over "
        "true"
    ]
    for (walk,), rows in grouped(results["rows"], "walk").items():
        ours = next(row for row in rows if row["given"] == OURS)
        parts.append(
            f"{walk}: {ours['way_m']:.1f} m, drift over {ours['segment_m']:.2g} m; depth of "
            f"{100 * ours['known']:.0f} % of the pixels, median error "
            f"{100 * ours['depth_error']:.1f} %\n{columns(rows, shown)}"
        )
    if len(parts) > 2:
        parts.append(f"mean\n{columns(results['pooled'], shown)}")
    return "\n\n".join(parts)


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    titles = ("sharp", "coded", "all-in-focus", "true depth", "depth of every pixel")
    for each in measured:
        name = each.cell.name.replace(" ", "_")
        seen_from_above(each.poses, folder / f"{name}.png")
        for given, poses in each.poses.items():
            write_tum(poses, folder / f"{name}_{given.replace(', ', '_').replace(' ', '_')}.tum")
        drawn = [
            [as_rgb(light, SRGB) for light in frames]
            + [_drawn(depth, each.range_m) for depth in depths]
            for *frames, true_m, depth_m in each.shown
            for depths in [(true_m, depth_m)]
        ]
        pictures = side_by_side(list(zip(titles, zip(*drawn, strict=True), strict=True)))
        write_image(folder / f"{name}_frames.jpg", of_width(pictures, _WIDTH_PX))


def _drawn(depth_m: FloatArray, range_m: tuple[float, float]) -> NDArray[np.uint8]:
    """Return a picture of the same size: without the bar below, which all have in common."""
    return depth_picture(depth_m, *range_m)[: depth_m.shape[0]]


SUITE = Suite(
    name="odometry",
    said=("length", "step", "noise", "mask"),
    description="Walk with a coded camera through random furnished rooms, and give depth and "
    "all-in-focus frames to the RGB-D odometry of Open3D, beside the same odometry with true "
    "depth. Rays are traced through every opening of the mask. The odometry compares each frame "
    "with the one before (intensity, three sizes of the picture), and begins where the last step "
    "would lead. Drift: root mean square of how far it is off after a metre, wherever that begins.",
    examples="""examples:
  two walks of 20 m (half an hour on two cores), with figures and trajectories for evo:
    python -m coded_aperture_benchmarks odometry --output walks/
  a short one:
    python -m coded_aperture_benchmarks odometry --rooms 1 --length 2
  an RGB-D video (see accuracy video) as a coded camera would see it, against odometry with its
  own depth:
    python -m coded_aperture_benchmarks odometry livingroom/
""",
    options=(
        options.folders("an RGB-D video, in place of rooms", "*"),
        options.number("--rooms", 1, 2, "that are walked through"),
        options.number("--first-room", 0, 1, "the number of the first", "N"),
        options.option("--length", "of a walk, m", 20.0, type=float, metavar="M"),
        options.option("--step", "from frame to frame, m", 0.05, type=float, metavar="M"),
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
