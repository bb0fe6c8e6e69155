"""Which side of the focal plane, in front or behind."""

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_benchmarks import figures, options
from coded_aperture_benchmarks.datasets.ray_traced import load_sharp
from coded_aperture_benchmarks.datasets.sides import (
    REACH_PX,
    SideEstimators,
    SideFrame,
    SideScore,
    focused_between,
    make_planes_on_both_sides,
    make_scene_on_both_sides,
    plane_camera,
)
from coded_aperture_benchmarks.datasets.textures import load_textures
from coded_aperture_benchmarks.methods.depth import RANGE_MARGIN
from coded_aperture_benchmarks.methods.identification import regularizations
from coded_aperture_benchmarks.rows import mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.optics import Camera, Mask, load_mask

_SCENE_REACH_PX = 12.0
_SHARES = ("right", "confident", "confident_right", "confident_said")
_LEVEL_ERRORS = (
    "level_error",
    "told_level_error",
    "confident_level_error",
    "told_confident_level_error",
)
_HEADER = [
    "frames", "mask", "asymmetry", "sigma", "regularize", "side right", "confident",
    "of it right", "said", "level error", "oracle", "confident", "oracle", "depth error",
    "oracle", "time",
]  # fmt: skip


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
    images: Path | None


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a cell, for JSON, and the maps of a scene, to be drawn."""

    row: Row
    maps: dict[str, Any]


def _cells(args: options.Args) -> list[Cell]:
    options.check_masks(args)
    options.check_known(args, "regularize", args.regularize, regularizations())
    counts = (args.levels, args.planes, args.repeats, args.seed)
    return [
        Cell(mask, scene, sigma, how, *counts, options.images_of(args))
        for scene, mask, sigma, how in itertools.product(
            args.scenes, args.masks, args.sigmas, args.regularize
        )
    ]


def measure(cell: Cell) -> Measured:
    """Measure one mask on planes or on a scene."""
    mask = load_mask(cell.mask)
    if cell.scene is None:
        camera, near_m, far_m = plane_camera(mask)
        frames = _planes(cell, camera)
    else:
        frame, camera, near_m, far_m = _scene(cell, cell.scene, mask)
        frames = iter([frame])
    config = DepthConfig(regularize=cell.regularize)
    estimators = SideEstimators(camera, near_m, far_m, cell.levels, config)
    estimates, seconds = [], []
    for frame in frames:
        estimates.append(estimators.estimate(frame))
        seconds.append(estimates[-1].both.seconds["focal side"])
    threshold = estimators.threshold
    score = SideScore.of(estimates, estimators.step_px, threshold)
    row = {
        "scene": "planes" if cell.scene is None else cell.scene.resolve().name,
        "mask": cell.mask,
        "asymmetry": round(mask.asymmetry, 3),
        "sigma": cell.sigma,
        "regularize": cell.regularize,
        # The results' names are older than the word oracle.
        **{
            name.replace("oracle", "told"): round(value, 4)
            for name, value in dataclasses.asdict(score).items()
        },
        "seconds_for_the_side": mean_of(seconds, 3),
    }
    last = estimates[-1]
    maps = {
        "true": last.frame.blur_size_px,
        "oracle of the side": last.oracle_size_px,
        "estimated": last.both.blur_size_px,
        "confident": last.both.where_confident(threshold).blur_size_px,
    }
    return Measured(row, {} if cell.scene is None else maps)


def _planes(cell: Cell, camera: Camera) -> Iterator[SideFrame]:
    textures = load_textures("natural", cell.images)
    sizes = np.linspace(-REACH_PX, REACH_PX, cell.planes)
    for seed in range(cell.seed, cell.seed + cell.repeats):
        yield from make_planes_on_both_sides(camera, textures, sizes, cell.sigma, seed)


def _scene(cell: Cell, folder: Path, mask: Mask) -> tuple[SideFrame, Camera, float, float]:
    """Return a coded frame of a scene, its camera and the ends of the depths that are learned."""
    sharp, depth_m = load_sharp(folder)
    near_m, far_m = float(depth_m.min()), float(depth_m.max())
    shape = (depth_m.shape[0], depth_m.shape[1])
    camera = focused_between(mask, near_m, far_m, shape, _SCENE_REACH_PX)
    frame = make_scene_on_both_sides(sharp, depth_m, camera, cell.sigma, cell.seed)
    return frame, camera, near_m * (1 - RANGE_MARGIN), far_m * (1 + RANGE_MARGIN)


def _results(args: options.Args, measured: list[Measured]) -> Row:
    return {"cells": [each.row for each in measured]}


def _text(results: Row) -> str:
    lines = [
        [
            row["scene"],
            row["mask"],
            f"{row['asymmetry']:.2f}",
            f"{row['sigma']:g}",
            row["regularize"],
            *(f"{100 * row[name]:.1f} %" for name in _SHARES),
            *(f"{row[name]:.2f}" for name in _LEVEL_ERRORS),
            *(f"{100 * row[name]:.1f} %" for name in ("depth_error", "told_depth_error")),
            f"{row['seconds_for_the_side']:.2f} s",
        ]
        for row in results["cells"]
    ]
    return (
        "side right: share of the pixels with 2 px of blur or more on the right side of the focal "
        "plane; confident:\nthose whose depth is confident, how many of these are right, and how "
        "many it was said would be\nlevel error: mean, of all pixels, and of the confident ones; "
        "depth error: median, relative, of these; oracle:\nthe same by one estimator for each "
        f"side, where the side of every pixel is known\n\n{table(_HEADER, lines)}"
    )


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    for each in measured:
        if each.maps:
            name = "_".join(str(each.row[key]) for key in ("scene", "mask", "sigma", "regularize"))
            figures.signed_blur_maps(each.maps, folder / f"{Path(name).name}.png")


SUITE = Suite(
    name="sign",
    said=("levels", "seed"),
    description="Measure how often the side of the focal plane is right, on simulated planes of "
    "320x240 px with photographs as texture, blurred by -20 to 20 px, or on scenes that are "
    "focused in their middle; and the error of the signed levels beside that of an oracle: one "
    "estimator for each side, where the side of every pixel is known.",
    examples="""examples:
  planes on both sides, through masks that are symmetric under a half turn and others:
    python -m coded_aperture_benchmarks sign
  two masks on a few planes, also of each patch by itself:
    python -m coded_aperture_benchmarks sign --masks zhou disc --planes 9 --levels 17 \\
        --regularize none semiglobal
  the sharp pictures and depths of ray-traced scenes, with the focus in their middle:
    python -m coded_aperture_benchmarks sign --masks zhou three_wide --scenes desk/ corridor/ \\
        --output results/
""",
    options=(
        options.masks("zhou", "three_wide", "three_hole", "veeraraghavan", "disc", "levin"),
        options.sigmas((0.001,)),
        options.option("--regularize", "none, semiglobal, ...", ["semiglobal"], metavar="HOW"),
        options.number("--levels", 3, 41, "blur levels, of both sides together"),
        options.number("--planes", 2, 40, "blur sizes of planes, equally spaced from -20 to 20 px"),
        options.number("--repeats", 1, 1, "planes of every blur size"),
        options.number("--seed", 0, 0, "of crops and noise"),
        options.IMAGES,
        options.option(
            "--scenes",
            "instead of planes: sharp picture and depth of ray-traced scenes (see bench accuracy "
            f"scenes), seen by a camera with blur of {_SCENE_REACH_PX:g} px at both ends of the "
            "depths",
            [None],
            said="",
            type=Path,
            metavar="FOLDER",
        ),
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
