"""`coded_aperture bench deblur scenes`: all-in-focus frames of ray-traced scenes."""

import argparse
import dataclasses
import itertools
import time
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from coded_aperture_benchmarks.commands.bench_cells import measure_cells
from coded_aperture_benchmarks.commands.bench_deblur_methods import (
    CODED,
    ESTIMATED,
    PRACTICE_SEED,
    TRUE,
    Practice,
    add_method_options,
    ahead,
    ahead_text,
    best_strengths,
    check_methods,
    deblur,
    nearest_level,
    own_methods,
    parameter_of,
)
from coded_aperture_benchmarks.commands.bench_deblur_pictures import (
    as_rgb,
    enlarged,
    of_width,
    side_by_side,
)
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
_PARTS = {"all": "all pixels", "away": f"more than {_NEAR_EDGE_PX} px from a depth edge"}
# The practice frame is a patchwork of photographs, none of which is smaller.
_PATCH_PX = 240
# Three blocks a side differ by less than the noise, and take twice the time.
_APERTURE_BLOCKS = 2
# Of the pictures: parts of the scene so large are shown so many times enlarged.
_CROP_PX = 96
_ENLARGED = 3
_EPILOG = """examples:
  two scenes, all methods, by the true and by the estimated depth, with pictures:
    coded_aperture bench deblur scenes desk/ corridor/ --output results/
  another mask that the scene was rendered with, one method, more noise:
    coded_aperture bench deblur scenes desk/ --masks four_hole --methods fast --noise 0.01
a scene's folder has:
  meta.json (camera and masks), depth_0.1mm.png, aif_linear.png, coded_MASK_linear.png
  or, for a video, whose first frame is used, depth_NNN.png, aif_NNN.png, coded_MASK_NNN.png
"""


@dataclasses.dataclass(frozen=True)
class View:
    """A scene through a mask, with noise, and how its depth is estimated."""

    folder: Path
    mask: str
    noise: float
    levels: int
    seed: int


@dataclasses.dataclass(frozen=True)
class Cell:
    """A view and a method."""

    view: View
    method: str


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """What every method is given of a view.

    Attributes
    ----------
    scene : RayTracedScene
    coded : ndarray of float32, shape [rows, columns, 3]
        With noise.
    stack : PsfStack
        Of the bank's levels.
    blur_size_px : dict of str to ndarray of float32, shape [rows, columns]
        By the true and by the estimated depth.
    parts : dict of str to ndarray of bool, shape [rows, columns]
        The pixels of `_PARTS`.
    """

    scene: Any
    coded: Any
    stack: Any
    blur_size_px: dict[str, Any]
    parts: dict[str, Any]


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a cell for each depth, for JSON, and the all-in-focus frames.

    A reference method has a frame for each part of the pixels, of the strength that suits that part
    best; the one for all pixels is kept.
    """

    view: View
    rows: list[dict[str, Any]]
    sharp: dict[str, Any]


def add_parser(subparsers: Any) -> None:
    """Add these frames to the parser of `bench deblur`."""
    parser = subparsers.add_parser(
        "scenes",
        help="ray-traced scenes with a true all-in-focus frame",
        description="Peak signal-to-noise ratio and structural similarity of the all-in-focus "
        "frames of ray-traced scenes, in linear light, and what they gain on the coded frame: by "
        "the true depth, and by the depth that is estimated from the same frame.",
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
    add_method_options(parser)
    add_result_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the benchmark; return its exit status."""
    from coded_aperture_benchmarks.ray_traced import scene_camera

    methods = check_methods(args, scikit_image_for="structural similarity")
    check_result_options(args)
    names = [folder.resolve().name for folder in args.folders]
    for folder, name in zip(args.folders, names, strict=True):
        for mask in args.masks:
            scene_camera(folder, mask)
        if names.count(name) > 1:  # rows and pictures are named after it
            raise InputError(f"{folder}: another scene's folder has this name too")
    views = [
        View(folder, mask, args.noise, args.levels, args.seed)
        for folder, mask in itertools.product(args.folders, args.masks)
    ]
    # Views vary slowest, so that a process estimates the depth of each of them once.
    cells = [Cell(view, method) for view in views for method in methods]
    start = time.perf_counter()
    measured = measure_cells(measure_cell, cells, args.jobs)
    rows = [row for view in views for row in _rows(view, measured)]
    found = {
        part: ahead(rows, ("scene", "mask", "depth"), lambda row, part=part: -row[part]["psnr_db"])  # type: ignore[misc]
        for part in _PARTS
    }
    report(
        args,
        {
            "benchmark": "deblur scenes",
            "noise": args.noise,
            "levels": args.levels,
            "seed": args.seed,
            "near_edge_px": _NEAR_EDGE_PX,
            "seconds": round(time.perf_counter() - start, 1),
            "cells": rows,
            "references_ahead": found,
        },
        lambda: "\n\n".join([_tables(rows), *_comparison(methods, rows, found)]),
        lambda folder: _draw(views, measured, folder),
    )
    return 0


def measure_cell(cell: Cell) -> Measured:
    """Deblur one view with one method, by both depths."""
    seen = _seen(cell.view)
    practice = None if cell.method in own_methods() else _practice(cell.view)
    strengths = best_strengths(
        cell.method,
        practice,
        {part: partial(_mean_square, part=where) for part, where in seen.parts.items()},
    )
    rows, sharp = [], {}
    for depth, blur in seen.blur_size_px.items():
        done = {
            strength: deblur(
                cell.method,
                seen.coded,
                blur,
                seen.stack,
                strength,
                exact_depth=depth == TRUE,
            )
            for strength in dict.fromkeys(strengths.values())
        }
        rows.append(
            {
                **_names(cell.view, cell.method, depth),
                **{
                    part: _score(done[strength].sharp, seen, part, strength)
                    for part, strength in strengths.items()
                },
                "parameter": parameter_of(cell.method),
                "seconds": round(done[strengths["all"]].seconds, 3),
            }
        )
        sharp[depth] = done[strengths["all"]].sharp
    return Measured(cell.view, rows, sharp)


def _names(view: View, method: str, depth: str | None) -> dict[str, Any]:
    scene = view.folder.resolve().name
    return {"scene": scene, "mask": view.mask, "method": method, "depth": depth}


def _rows(view: View, measured: Sequence[Measured]) -> list[dict[str, Any]]:
    """Return the rows of a view: first the coded frame's own, then what is gained on it."""
    seen = _seen(view)
    coded = {
        **_names(view, CODED, None),
        **{part: _score(seen.coded, seen, part, None) for part in _PARTS},
        "parameter": None,
        "seconds": None,
    }
    rows = [coded, *(row for cell in measured if cell.view == view for row in cell.rows)]
    for row, part in itertools.product(rows, _PARTS):
        for score in ("psnr_db", "ssim"):
            row[part][f"{score}_gain"] = round(row[part][score] - coded[part][score], 4)
    return rows


def _score(image: Any, seen: Seen, part: str, strength: float | None) -> dict[str, Any]:
    from coded_aperture_benchmarks.restoration import picture_score

    score = picture_score(image, seen.scene.sharp, seen.parts[part])
    return {
        "psnr_db": round(score.psnr_db, 3),
        "ssim": round(score.ssim, 4),
        "pixels": score.pixels,
        "strength": strength,
    }


# A process works through its cells in order of views.
@lru_cache(maxsize=2)
def _seen(view: View) -> Seen:
    import numpy as np

    from coded_aperture_benchmarks.ray_traced import RayTracedScene
    from coded_aperture_ros.bank import learn_bank_for_camera
    from coded_aperture_ros.depth import DepthConfig, DepthEstimator

    (scene,) = RayTracedScene.load_views(view.folder, view.mask, 1)
    nearest_m = float(np.nanmin(scene.depth_m)) * (1 - _RANGE_MARGIN)
    farthest_m = float(np.nanmax(scene.depth_m)) * (1 + _RANGE_MARGIN)
    bank = learn_bank_for_camera(scene.camera, nearest_m, farthest_m, view.levels)
    random = np.random.default_rng(view.seed)
    noise = np.float32(view.noise) * random.standard_normal(scene.coded.shape, dtype=np.float32)
    coded = scene.coded + noise
    # Every pixel has a depth, so that nothing is gained by leaving pixels as they are.
    estimator = DepthEstimator(bank, DepthConfig(confidence_threshold=0.0), scene.camera)
    maps = {
        TRUE: scene.camera.blur_size_px(scene.depth_m),
        ESTIMATED: estimator.estimate(coded).blur_size_px,
    }
    return Seen(
        scene=scene,
        coded=coded,
        stack=bank.stack,
        blur_size_px={
            name: _without_gaps(np.asarray(blur, np.float32)) for name, blur in maps.items()
        },
        parts={
            "all": np.ones(scene.depth_m.shape, bool),
            "away": scene.edge_distance_px() > _NEAR_EDGE_PX,
        },
    )


def _without_gaps(blur_size_px: Any) -> Any:
    """Return a map with the nearest known value where there is none."""
    import numpy as np
    from scipy import ndimage

    unknown = ~np.isfinite(blur_size_px)
    if unknown.all():
        raise InputError("no pixel of the scene has a known depth")
    row, column = ndimage.distance_transform_edt(
        unknown, return_distances=False, return_indices=True
    )
    return blur_size_px[row, column]


@lru_cache(maxsize=1)
def _practice(view: View) -> Practice:
    """Return other pictures in front of the same camera, at the same depths."""
    import numpy as np

    from coded_aperture_ros.imaging import SRGB, decode
    from coded_aperture_ros.io.textures import training_textures
    from coded_aperture_ros.simulation import render_coded_frame

    seen = _seen(view)
    shape = seen.coded.shape[:2]
    down, across = (-(-side // _PATCH_PX) for side in shape)
    rows, columns = -(-shape[0] // down), -(-shape[1] // across)
    random = np.random.default_rng([PRACTICE_SEED, view.seed])
    patches = training_textures().crops(down * across, rows, columns, random)
    patchwork = patches.reshape(down, across, rows, columns).swapaxes(1, 2)
    sharp = decode(patchwork.reshape(down * rows, -1)[: shape[0], : shape[1]], SRGB)
    sharp = np.asarray(sharp, np.float32)
    coded = render_coded_frame(
        sharp, seen.scene.depth_m, seen.scene.camera, aperture_blocks=_APERTURE_BLOCKS
    )
    coded += np.float32(view.noise) * random.standard_normal(coded.shape, dtype=np.float32)
    level = nearest_level(seen.blur_size_px[TRUE], seen.stack)
    return Practice(coded, sharp, level, seen.stack)


def _mean_square(image: Any, truth: Any, part: Any) -> float:
    """Return that of a part of the pixels; 0 where the scene has no such part."""
    return float(((image - truth)[part] ** 2).mean()) if part.any() else 0.0


def _tables(rows: Sequence[dict[str, Any]]) -> str:
    parts = [
        "peak signal-to-noise ratio in dB (gain on the coded frame) / structural similarity (gain)"
    ]
    for scene, mask in dict.fromkeys((row["scene"], row["mask"]) for row in rows):
        here = [row for row in rows if (row["scene"], row["mask"]) == (scene, mask)]
        lines = [
            [
                row["method"],
                row["depth"] or "-",
                *(_score_text(row[part]) for part in _PARTS),
                "-" if row["seconds"] is None else f"{row['seconds']:.1f} s",
            ]
            for row in here
        ]
        header = ["method", "depth", *_PARTS.values(), "time"]
        parts.append(f"{scene}, mask {mask}\n{table(header, lines)}")
    return "\n\n".join(parts)


def _score_text(score: dict[str, Any]) -> str:
    return (
        f"{score['psnr_db']:.2f} ({score['psnr_db_gain']:+.2f}) / "
        f"{score['ssim']:.3f} ({score['ssim_gain']:+.3f})"
    )


def _comparison(
    methods: Sequence[str],
    rows: Sequence[dict[str, Any]],
    found: dict[str, list[dict[str, Any]]],
) -> list[str]:
    own = [method in own_methods() for method in methods]
    if not any(own) or all(own):
        return []
    cells = sum(row["method"] == methods[0] for row in rows)
    return [
        f"{title}, by signal-to-noise ratio: {ahead_text(found[part], cells)}"
        for part, title in _PARTS.items()
    ]


def _draw(views: Sequence[View], measured: Sequence[Measured], folder: Path) -> None:
    """Write a picture for every view and depth: the frames, and parts of them enlarged."""
    from coded_aperture_ros.io import write_image

    for view in views:
        seen = _seen(view)
        here = [cell for cell in measured if cell.view == view]
        crops = _telling_crops(seen)
        for index, depth in enumerate(seen.blur_size_px):
            frames = [("coded", seen.coded), ("truth", seen.scene.sharp)]
            for cell in here:
                row = cell.rows[index]
                title = f"{row['method']} {row['all']['psnr_db_gain']:+.2f} dB"
                frames.append((title, cell.sharp[depth]))
            columns = [(title, _shown(frame, crops)) for title, frame in frames]
            name = f"{view.folder.resolve().name}_{view.mask}_{depth}.png"
            write_image(folder / name, side_by_side(columns))


def _shown(frame: Any, crops: Sequence[tuple[slice, slice]]) -> list[Any]:
    """Return the whole frame, and its crops enlarged to the same width."""
    from coded_aperture_ros.imaging import SRGB

    whole = of_width(as_rgb(frame, SRGB), _ENLARGED * _CROP_PX)
    return [whole, *(enlarged(as_rgb(frame[crop], SRGB), _ENLARGED) for crop in crops)]


def _telling_crops(seen: Seen) -> list[tuple[slice, slice]]:
    """Return the most textured place with a depth edge, and the most textured one without."""
    import numpy as np

    grey = seen.scene.sharp.mean(axis=2)
    height, width = grey.shape
    places = [
        (slice(top, top + _CROP_PX), slice(left, left + _CROP_PX))
        for top in range(0, max(height - _CROP_PX, 0) + 1, _CROP_PX // 2)
        for left in range(0, max(width - _CROP_PX, 0) + 1, _CROP_PX // 2)
    ]

    def texture(place: tuple[slice, slice]) -> float:
        part = grey[place]
        return float(sum(np.mean(np.diff(part, axis=axis) ** 2) for axis in (0, 1)))

    away = [float(np.mean(seen.parts["away"][place])) for place in places]
    with_edge = [place for place, share in zip(places, away, strict=True) if share < 0.7]
    without = [place for place, share in zip(places, away, strict=True) if share > 0.9]
    return [max(group, key=texture) for group in (with_edge, without) if group]
