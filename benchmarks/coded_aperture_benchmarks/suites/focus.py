"""Two frames at two focus settings, beside one of twice the light."""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.methods.depth import CameraBank
from coded_aperture_benchmarks.metrics.relative import published_shares, relative_error
from coded_aperture_benchmarks.pictures import frames_and_depths
from coded_aperture_benchmarks.rows import grouped, mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.depth import DepthConfig, DepthEstimate, DepthEstimator
from coded_aperture_ros.depth.focus_pair import FocusPair
from coded_aperture_ros.io import write_image
from coded_aperture_ros.optics import load_mask
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.simulation.layered import LayeredScene, random_scene

_LEVELS = 30
_SIZE = (288, 384)
_FIRST_SCENE = 4_500_000
_BLUR_PX = {"beyond": (2.0, 14.0), "within": (-8.0, 8.0), "both within": (-5.0, 9.0)}
# Where the second focus is, in shares of the range of inverse depths from its far end.
_SECOND = {"beyond": -0.15, "within": 1.2, "both within": 0.35}
SETTINGS = tuple(_SECOND)


@dataclasses.dataclass(frozen=True)
class Cell:
    """A scene, and where the two frames are in focus."""

    setting: str
    mask: str
    number: int
    noise: float


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """Rows for each way to look, and the maps."""

    cell: Cell
    rows: list[Row]
    frames: dict[str, FloatArray]
    depth_m: dict[str, FloatArray]


def _cells(args: argparse.Namespace) -> list[Cell]:
    options.check_masks(args)
    return [
        Cell(setting, mask, number, args.noise)
        for setting in SETTINGS
        for mask in args.masks
        for number in range(args.scenes)
    ]


def measure(cell: Cell) -> Measured:
    """Look at a scene with one frame, with one of twice the exposure, and with two."""
    side = "far" if cell.setting == "beyond" else "both"
    seed, blur_px = _FIRST_SCENE + cell.number, _BLUR_PX[cell.setting]
    scene = random_scene(seed, load_mask(cell.mask), side, _SIZE, blur_px)
    true_m, camera = scene.depth_m(), scene.camera
    near_m, far_m = float(np.nanmin(true_m)), float(np.nanmax(true_m))
    at_focus = 1 / far_m + _SECOND[cell.setting] * (1 / near_m - 1 / far_m)
    focus_m = 1 / max(at_focus, 0.1 / far_m)
    random = np.random.default_rng(cell.number)

    def exposed(seen: LayeredScene, exposures: int = 1) -> FloatArray:
        return SensorModel(cell.noise / np.sqrt(exposures)).expose(seen.coded(), random)

    first, second, long = exposed(scene), exposed(scene.refocused(focus_m)), exposed(scene, 2)
    bank = CameraBank.of_scene(camera, true_m, _LEVELS).learn()
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0), camera)
    pair = FocusPair(estimator, focus_m)
    found = {
        "first": estimator.estimate(first),
        "first, twice the exposure": estimator.estimate(long),
        "both": pair.estimate(first, second),
    }
    pair.close()
    estimator.close()
    rows = [
        {
            "setting": cell.setting,
            "mask": cell.mask,
            "number": cell.number,
            "given": given,
            **_scores(estimate, true_m),
        }
        for given, estimate in found.items()
    ]
    maps = {given: np.asarray(estimate.depth_m) for given, estimate in found.items()}
    return Measured(cell, rows, {"first": first, "second": second}, {"truth": true_m, **maps})


def _scores(estimate: DepthEstimate, true_m: FloatArray) -> Row:
    known = np.isfinite(true_m)
    error = relative_error(estimate, true_m)[known]
    return {
        "median_error": float(np.nanmedian(error)),
        **published_shares(error, estimate.confidence[known]),
        "fits": estimate.health is None or estimate.health.fits,
    }


def _results(args: argparse.Namespace, measured: list[Measured]) -> Row:
    rows = [row for each in measured for row in each.rows]
    return {
        "rows": rows,
        "pooled": [
            {"setting": setting, "mask": mask, "given": given, **_pooled(group)}
            for (setting, mask, given), group in grouped(rows, "setting", "mask", "given").items()
        ],
    }


def _pooled(rows: list[Row]) -> Row:
    sure = [row for row in rows if row["right_of_published"] is not None]
    share = sum(row["published"] for row in sure)
    right = sum(row["published"] * row["right_of_published"] for row in sure)
    return {
        **{
            name: mean_of((row[name] for row in rows), 4) for name in ("right", "published", "fits")
        },
        "median_error": round(float(np.median([row["median_error"] for row in rows])), 4),
        "worst": round(min(row["right"] for row in rows), 3),
        "right_of_published": round(right / share, 4) if share else None,
    }


def _text(results: Row) -> str:
    shown = {
        "focus": "{setting}",
        "mask": "{mask}",
        "frames": "{given}",
        "within 10 %": lambda row: f"{100 * row['right']:.1f} %",
        "worst scene": lambda row: f"{100 * row['worst']:.0f} %",
        "median error": lambda row: f"{100 * row['median_error']:.1f} %",
        "published": lambda row: f"{100 * row['published']:.1f} %",
        "right of these": lambda row: (
            "-" if row["right_of_published"] is None else f"{100 * row['right_of_published']:.1f} %"
        ),
    }
    return "\n".join(
        [
            f"{results['scenes']} scenes each, noise {results['noise']:g}; beyond: focused before "
            "the scene, then beyond it; within: in its middle, then before it; both within: twice "
            "in it",
            columns(results["pooled"], shown),
        ]
    )


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    for each in measured:
        if each.cell.number == 0:
            true_m = each.depth_m["truth"]
            ends_m = float(np.nanmin(true_m)), float(np.nanmax(true_m))
            name = f"{each.cell.setting.replace(' ', '_')}_{each.cell.mask}.jpg"
            write_image(folder / name, frames_and_depths(each.frames, each.depth_m, ends_m))


SUITE = Suite(
    name="focus",
    said=("masks", "scenes", "noise"),
    description="Depth from two frames of one view at two focus settings (depth "
    "--refocused-frame), of random layered scenes, beside one frame and one of twice the exposure, "
    "whose noise has half the variance. With scenes beyond the focal plane, and with scenes that "
    "go through it.",
    examples="""examples:
  12 scenes of each kind (some minutes), with pictures:
    python -m coded_aperture_benchmarks focus --output focus/
""",
    options=(
        options.number("--scenes", 1, 12, "of each kind"),
        options.masks("levin", "three_wide"),
        options.added_noise(0.004),
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
