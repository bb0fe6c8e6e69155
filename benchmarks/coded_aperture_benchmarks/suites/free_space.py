"""How often something is nearer than the bound, at what cost."""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.arguments import noise_level
from coded_aperture_benchmarks.datasets.cameras import camera_for_blur
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene
from coded_aperture_benchmarks.datasets.room import random_room, walk
from coded_aperture_benchmarks.methods.depth import bank_with_refinement, predict
from coded_aperture_benchmarks.metrics.relative import PUBLISHED
from coded_aperture_benchmarks.pictures import frames_and_depths
from coded_aperture_benchmarks.rows import grouped, mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.io import write_image
from coded_aperture_ros.optics import Camera, load_mask
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.simulation.layered import random_scene

_LEVELS, _SIZE = 30, (288, 384)
KINDS = ("room", "empty", "layered")
_MASKS, _NOISES = ("levin", "four_hole", "zhou"), (0.0005, 0.002, 0.005)
_RISKS, _LARGEST_RISK = (0.01, 0.003, 0.001), 0.1
_FIRST_ROOM, _FIRST_SCENE = 500, 2_500_000
_FOCAL_LENGTH_PX, _ROOM_M, _ROOM_BLUR_PX = 600.0, (0.8, 7.0), (2.0, 16.0)
_NEARER = 0.9


@dataclasses.dataclass(frozen=True)
class Cell:
    """A frame: of a kind of random scene, or of a ray-traced scene's folder."""

    kind: str
    number: int
    mask: str
    noise: float
    risks: tuple[float, ...]
    folder: Path | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """What a frame shows, without noise."""

    coded: FloatArray
    depth_m: FloatArray
    camera: Camera


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """A row for each risk, and the frame, the truth and the bounds."""

    cell: Cell
    rows: list[Row]
    frame: FloatArray
    depth_m: FloatArray
    bounds_m: dict[float, FloatArray]


def _cells(args: argparse.Namespace) -> list[Cell]:
    options.check_masks(args)
    traced = options.folders_behind_masks(args)
    risks = tuple(sorted(args.risks, reverse=True))
    if not 0 < risks[-1] <= risks[0] <= _LARGEST_RISK:
        args.usage_error(f"--risks: expected more than 0 and at most {_LARGEST_RISK:g}")
    if traced:
        return [
            Cell(folder.resolve().name, 0, mask, args.noise, risks, folder)
            for folder, mask in traced
        ]
    count = len(args.masks)
    return [
        Cell(kind, number, args.masks[number % count], _NOISES[number // count % 3], risks)
        for kind in KINDS
        for number in range(args.frames)
    ]


def _seen(cell: Cell) -> Seen:
    mask = load_mask(cell.mask)
    if cell.folder is not None:
        scene = RayTracedScene.load(cell.folder, cell.mask)
        return Seen(scene.coded, scene.depth_m, scene.camera)
    if cell.kind == "room":
        camera = camera_for_blur(mask, _FOCAL_LENGTH_PX, _SIZE, _ROOM_M, _ROOM_BLUR_PX)
        seed = _FIRST_ROOM + cell.number
        room, poses = random_room(seed), walk(seed, 10, 0.5)
        pose = poses[seed % len(poses)]
        return Seen(room.coded(camera, pose), room.seen(camera, pose)[1], camera)
    # One in six before the focal plane, behind each mask.
    side = "near" if cell.number // len(_MASKS) % 6 == 5 else "far"
    seed = _FIRST_SCENE + cell.number
    layered = random_scene(seed, mask, side, _SIZE, empty=cell.kind == "empty")
    return Seen(layered.coded(), layered.depth_m(), layered.camera)


def measure(cell: Cell) -> Measured:
    """Take a frame, and ask for the bound at every risk."""
    seen = _seen(cell)
    frame = SensorModel(cell.noise).expose(seen.coded, np.random.default_rng(cell.number))
    ends_m = float(np.nanmin(seen.depth_m)), float(np.nanmax(seen.depth_m))
    bank = bank_with_refinement(seen.camera, ends_m, _LEVELS)
    rows, bounds_m = [], {}
    known = seen.depth_m > 0
    # In inverse depth, as blur goes by that: 0 for the nearest level, 1 for the truth.
    nearest = 1 / bank.near_m
    for risk in cell.risks:
        estimate = predict(frame, bank, DepthConfig(free_space_risk=risk), seen.camera)
        bound = estimate.values("free_space")
        assert bound is not None and estimate.depth_m is not None
        bounds_m[risk], truth = bound, seen.depth_m[known]
        there, found = bound[known], estimate.depth_m[known]
        range_of_all = (nearest - 1 / truth).sum()
        rows.append(
            {
                "kind": cell.kind,
                "number": cell.number,
                "mask": cell.mask,
                "noise": cell.noise,
                "risk": risk,
                "nearer": float((truth < there).mean()),
                "gain": float((nearest - 1 / np.minimum(there, truth)).sum() / range_of_all),
                "of_truth": float(np.median(there / truth)),
                # What stands nearer than nine tenths of the depth that is published.
                "published": float((estimate.confidence >= PUBLISHED).mean()),
                "nearer_than_published": float((truth < _NEARER * found).mean()),
                "fits": estimate.health is None or estimate.health.fits,
            }
        )
    return Measured(cell, rows, frame, seen.depth_m, bounds_m)


def _pooled(rows: list[Row]) -> Row:
    return {
        "frames": len(rows),
        "nearer": mean_of((row["nearer"] for row in rows), 6),
        "worst": round(max(row["nearer"] for row in rows), 5),
        "holds": sum(row["nearer"] <= row["risk"] for row in rows),
        "gain": mean_of((row["gain"] for row in rows), 3),
        "of_truth": round(float(np.median([row["of_truth"] for row in rows])), 3),
        "published": mean_of((row["published"] for row in rows), 3),
        "nearer_than_published": mean_of((row["nearer_than_published"] for row in rows), 5),
    }


def _by(rows: list[Row], *names: str) -> list[Row]:
    """Return what is measured at each risk, of each kind or mask, or of all."""
    return [
        {"risk": risk, "of": of[0] if of else "all", **_pooled(group)}
        for (risk, *of), group in grouped(rows, "risk", *names).items()
    ]


def _results(args: argparse.Namespace, measured: list[Measured]) -> Row:
    rows = [row for each in measured for row in each.rows if row["fits"]]
    every = [row for each in measured for row in each.rows]
    return {
        "folders": [str(folder) for folder in args.folders],
        "fitting": sum(each.rows[0]["fits"] for each in measured),
        "of": len(measured),
        "rows": every,
        "by_kind": _by(rows, "kind"),
        "by_mask": _by(rows, "mask"),
        "all": _by(rows),
    }


def _text(results: Row) -> str:
    shown = {
        "risk": lambda row: f"{100 * row['risk']:g} %",
        "of": "{of}",
        "frames": "{frames}",
        "nearer than the bound": lambda row: f"{100 * row['nearer']:.2f} %",
        "in the worst frame": lambda row: f"{100 * row['worst']:.1f} %",
        "held in": "{holds}",
        "of the range": "{gain:.2f}",
        "bound / truth": "{of_truth:.2f}",
        "depth published": lambda row: f"{100 * row['published']:.0f} %",
        "nearer than 0.9 of it": lambda row: f"{100 * row['nearer_than_published']:.1f} %",
    }
    parts = [
        f"{results['fitting']} of {results['of']} frames fit their bank; only these are counted\n"
        "of the range: in inverse depth, 0 if the bound is always the nearest level, 1 if "
        "it is the truth"
    ]
    for name in ("by_kind", "by_mask", "all"):
        rows = sorted(results[name], key=lambda row: (-row["risk"], -row["nearer"]))
        parts.append(columns(rows, shown))
    return "\n\n".join(parts)


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    for each in measured:
        if each.cell.number == 0:
            ends_m = float(np.nanmin(each.depth_m)), float(np.nanmax(each.depth_m))
            maps = {"truth": each.depth_m}
            maps |= {
                f"bound, risk {100 * risk:g} %": found for risk, found in each.bounds_m.items()
            }
            picture = frames_and_depths({"frame": each.frame}, maps, ends_m)
            write_image(folder / f"{each.cell.kind}_{each.cell.mask}.jpg", picture)


SUITE = Suite(
    name="free-space",
    said=("masks", "risks", "frames"),
    description="Bounds on free space (depth --free-space-risk) of random frames that were not "
    "used to set them: furnished rooms, empty ones, and layers of all kinds of things, behind "
    "three masks and with three noises; or of ray-traced scenes. How many pixels show something "
    "that is nearer than the bound, and how much of the range is given up for that.",
    examples="""examples:
  36 random frames of each kind (some minutes), with pictures:
    python -m coded_aperture_benchmarks free-space --output bounds/
  a ray-traced scene (see accuracy scenes):
    python -m coded_aperture_benchmarks free-space desk/
""",
    options=(
        options.folders("ray-traced scenes, in place of random ones", "*"),
        options.number("--frames", 1, 36, "random frames of each kind"),
        options.option(
            "--risks", "shares of pixels that may be nearer", list(_RISKS), type=float, metavar="R"
        ),
        options.masks(*_MASKS),
        options.option("--noise", "of ray-traced scenes", 0.002, type=noise_level, metavar="S"),
        *options.DEPTH_RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
