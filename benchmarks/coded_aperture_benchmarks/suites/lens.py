"""Depth through a real lens, before and after `calibrate field`."""

import argparse
import dataclasses
import functools
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene
from coded_aperture_benchmarks.methods.depth import CameraBank, predict
from coded_aperture_benchmarks.metrics.relative import PUBLISHED, RIGHT, relative_error
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.calibration.planes.field import fit_field
from coded_aperture_ros.calibration.planes.folder import load_planes
from coded_aperture_ros.calibration.planes.wavefront import fit_wavefront
from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.depth import DepthConfig, DepthEstimate
from coded_aperture_ros.optics import Camera

_MASK, _EXACT = "levin", 0.05
_THIRDS = ("inner", "middle", "outer")
_HEADER = [
    "scene", "seed", "field curvature", "error: all", *_THIRDS, "confident", "of it right", "said",
    *(f"published {name}" for name in _THIRDS),
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Cell:
    """A scene with noise of a seed, and the planes that its lens is measured with."""

    scene: Path
    planes: Path
    sigma: float
    levels: int
    seed: int
    psfs: bool


def _cells(args: argparse.Namespace) -> list[Cell]:
    if args.planes is None:
        args.usage_error("--planes: name the folder with planes of the lens")
    options.check_names(args.folders, "scenes")
    return [
        Cell(scene, args.planes, args.noise, args.levels, seed, args.psfs)
        for scene in args.folders
        for seed in range(args.seed, args.seed + args.repeats)
    ]


def measure(cell: Cell) -> list[Row]:
    """Measure a scene with the camera as it was, and with what planes tell of its lens."""
    scene = RayTracedScene.load(cell.scene, _MASK)
    noise = np.random.default_rng(cell.seed).standard_normal(scene.coded.shape, dtype=np.float32)
    frame = scene.coded + np.float32(cell.sigma) * noise
    return [
        {
            "scene": cell.scene.resolve().name,
            "seed": cell.seed,
            "field_curvature": camera.field_curvature is not None,
            "psfs": camera.wavefront is not None,
            **_scores(scene, camera, frame, cell.levels),
        }
        for camera in (scene.camera, *_of_planes(cell.scene, cell.planes, cell.psfs))
    ]


@functools.lru_cache(maxsize=1)
def _of_planes(scene: Path, folder: Path, psfs: bool) -> list[Camera]:
    camera, planes = RayTracedScene.load(scene, _MASK).camera, load_planes([folder])
    found = fit_field(camera, planes)
    if not psfs:
        return [found.camera]
    return [found.camera, fit_wavefront(found.camera, planes, found.trusted, iter)]


def _scores(scene: RayTracedScene, camera: Camera, frame: np.ndarray, levels: int) -> Row:
    true = scene.depth_m
    bank = CameraBank.of_scene(camera, true, levels)
    estimate = predict(frame, bank, DepthConfig(confidence_threshold=0.0), camera)
    error = relative_error(estimate, true)
    known = np.isfinite(error)
    rows, columns = (np.arange(length) - (length - 1) / 2 for length in true.shape)
    radius = np.hypot(rows[:, None], columns) / np.hypot(rows[-1], columns[-1])
    third = np.minimum((3 * radius).astype(int), 2)
    sure = known & (estimate.confidence >= PUBLISHED)
    return {
        "all": _median(error[known]),
        **{name: _median(error[known & (third == i)]) for i, name in enumerate(_THIRDS)},
        "confident": round(float(sure.mean()), 4),
        "right": _share(error[sure] <= _EXACT),
        "said": _share(estimate.confidence[sure]),
        "published": {
            name: _of_published(estimate, error, true, known & (third == i), sure)
            for i, name in enumerate(_THIRDS)
        },
    }


def _of_published(
    estimate: DepthEstimate, error: FloatArray, true_m: FloatArray, part: BoolArray, sure: BoolArray
) -> Row:
    """Return how much of a part of the frame is published, and of that the shares that are right.

    `right`: within 10 %; `within_deviation`: within the standard deviation that is stated.
    """
    assert estimate.depth_m is not None and estimate.std_dev_m is not None
    some = part & sure
    off = np.abs(estimate.depth_m - true_m)
    return {
        "coverage": _share(sure[part]),
        "right": _share(error[some] <= RIGHT),
        "within_deviation": _share(off[some] <= estimate.std_dev_m[some]),
    }


def _share(values: np.ndarray) -> float | None:
    return round(float(values.mean()), 4) if values.size else None


def _median(values: np.ndarray) -> float | None:
    return round(float(np.median(values)), 4) if values.size else None


def _text(results: Row) -> str:
    names = ("all", *_THIRDS, "confident", "right", "said")
    lines = [
        [
            row["scene"],
            str(row["seed"]),
            "PSFs of the parts" if row["psfs"] else "with" if row["field_curvature"] else "without",
            *("-" if row[name] is None else f"{100 * row[name]:.1f} %" for name in names),
            *(_published_text(row["published"][name]) for name in _THIRDS),
        ]
        for row in results["cells"]
    ]
    return (
        "error: median, relative, of every pixel and by thirds of the radius; confident: share of "
        "the frame, how\nmany of these are right to 5 %, and how many it was said would be; "
        "published, by thirds: share of the third, of that right\nto 10 %, and within the standard "
        "deviation that is stated\n\n" + table(_HEADER, lines)
    )


def _published_text(row: Row) -> str:
    return ", ".join("-" if value is None else f"{100 * value:.0f} %" for value in row.values())


SUITE = Suite(
    name="lens",
    said=("noise", "levels"),
    description="Measure depth of ray-traced scenes through a lens whose focus moves towards the "
    "corners, with a camera file as from the data sheet, and with what calibrate field finds from "
    "pictures of planes.",
    examples="""examples:
  python -m coded_aperture_benchmarks lens desk/ --planes calib/
""",
    options=(
        options.folders("ray-traced scenes of levin's mask"),
        options.option(
            "--planes", "folder with planes.json of the same lens", type=Path, metavar="DIR"
        ),
        options.option(
            "--psfs", "also with what calibrate field --psfs finds, minutes", action="store_true"
        ),
        options.added_noise(0.002),
        options.number("--levels", 2, 30, "blur levels of the banks"),
        options.number("--repeats", 1, 1, "seeds of the noise"),
        options.number("--seed", 0, 0, "first seed"),
        *options.DEPTH_RESULTS,
    ),
    cells=_cells,
    measure=measure,
    text=_text,
)
