"""All-in-focus frames of ray-traced scenes."""

import dataclasses
import itertools
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene, scene_camera
from coded_aperture_benchmarks.datasets.textures import training_textures
from coded_aperture_benchmarks.methods import deblurring
from coded_aperture_benchmarks.methods.depth import CameraBank, predict
from coded_aperture_benchmarks.metrics.restoration import overshoot, picture_score
from coded_aperture_benchmarks.pictures import as_rgb, enlarged, of_width, side_by_side
from coded_aperture_benchmarks.rows import or_dash, tables
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.frames import SRGB, decode
from coded_aperture_ros.io import write_image
from coded_aperture_ros.optics import PsfStack
from coded_aperture_ros.simulation import render_coded_frame

_NEAR_EDGE_PX = 16
_PARTS = {
    "all": "all pixels",
    "near": f"within {_NEAR_EDGE_PX} px of a depth edge",
    "away": "farther from depth edges",
}
# By their numbers in an `Uncertainty`.
_KINDS = ("filled", "uncertain", "seen")
# The practice frame is a patchwork of photographs, none of which is smaller.
_PATCH_PX = 240
# Three blocks a side differ by less than the noise, and take twice the time.
_APERTURE_BLOCKS = 2
# Of the pictures: parts of the scene so large are shown so many times enlarged.
_CROP_PX = 96
_ENLARGED = 3

Place = tuple[slice, slice]


@dataclasses.dataclass(frozen=True)
class View:
    """A scene through a mask, with noise, and how its depth is estimated."""

    folder: Path
    mask: str
    noise: float
    levels: int
    seed: int

    @property
    def name(self) -> str:
        """The scene's."""
        return self.folder.resolve().name


@dataclasses.dataclass(frozen=True)
class Cell:
    """A view and a method; CODED for the frame itself."""

    view: View
    method: str


@dataclasses.dataclass(frozen=True, eq=False)
class Seen:
    """What every method is given of a view.

    Attributes
    ----------
    coded : ndarray of float32, shape [rows, columns, 3]
        With noise.
    stack : PsfStack
        Of the bank's levels.
    blur_size_px : dict of str to ndarray of float32, shape [rows, columns]
        By the true depth, by the one that is estimated, and by one without refinement; not finite
        where unknown.
    parts : dict of str to ndarray of bool, shape [rows, columns]
        The pixels of `_PARTS`.
    """

    scene: RayTracedScene
    coded: deblurring.Picture
    stack: PsfStack
    blur_size_px: dict[str, deblurring.Picture]
    parts: dict[str, NDArray[np.bool_]]


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a cell for each depth, for JSON, and the all-in-focus frames.

    A reference method has a frame for each part of the pixels, of the strength that suits that part
    best; the one for all pixels is kept.
    """

    view: View
    rows: list[Row]
    sharp: dict[str, deblurring.Picture]


def _cells(args: options.Args) -> list[Cell]:
    methods = deblurring.chosen_methods(args, scikit_image_for="structural similarity")
    for folder, mask in itertools.product(args.folders, args.masks):
        scene_camera(folder, mask)
    options.check_names(args.folders, "scene")
    return [
        Cell(View(folder, mask, args.noise, args.levels, args.seed), method)
        # Views vary slowest, so that a process estimates the depth of each of them once.
        for folder, mask in itertools.product(args.folders, args.masks)
        for method in (deblurring.CODED, *methods)
    ]


def measure(cell: Cell) -> Measured:
    """Deblur one view with one method, by both depths."""
    seen = _seen(cell.view)
    if cell.method == deblurring.CODED:
        scores = {part: _score(seen.coded, seen, part, None) for part in _PARTS}
        return Measured(cell.view, [_row(cell, None, scores, _ringing(seen.coded, seen), None)], {})
    errors = {part: partial(_mean_square, part=where) for part, where in seen.parts.items()}
    strengths = deblurring.best_strengths(cell.method, partial(_practice, cell.view), errors)
    rows, sharp = [], {}
    for depth, blur in seen.blur_size_px.items():
        done = {
            strength: deblurring.deblur(cell.method, seen.coded, blur, seen.stack, strength)
            for strength in dict.fromkeys(strengths.values())
        }
        scores = {
            part: _score(done[strength].sharp, seen, part, strength)
            for part, strength in strengths.items()
        }
        best = done[strengths["all"]]
        ringing = _ringing(best.sharp, seen)
        row = _row(cell, depth, scores, ringing, round(best.seconds, 3))
        rows.append({**row, "uncertainty": _relied_on(best, seen.scene.sharp)})
        sharp[depth] = best.sharp
    return Measured(cell.view, rows, sharp)


def _relied_on(done: deblurring.Deblurred, truth: deblurring.Picture) -> Row:
    """Return how many of all values are within the stated standard deviation; and by kind."""
    if done.uncertainty is None:
        return {}
    error = np.abs(np.atleast_3d(done.sharp - truth))
    within = (error <= done.uncertainty.std_dev[..., None]).mean(axis=2)
    kinds = {kind: done.uncertainty.kind == number for number, kind in enumerate(_KINDS)}
    return {
        "within_std_dev": float(within.mean()),
        **{
            kind: {
                "share": float(where.mean()),
                "rms_error": float(np.sqrt((error[where] ** 2).mean())) if where.any() else None,
                "within_std_dev": float(within[where].mean()) if where.any() else None,
            }
            for kind, where in kinds.items()
        },
    }


def _row(
    cell: Cell, depth: str | None, scores: Row, overshoot: float, seconds: float | None
) -> Row:
    names = {"scene": cell.view.name, "mask": cell.view.mask, "method": cell.method, "depth": depth}
    return {
        **names,
        **scores,
        "overshoot": overshoot,
        "parameter": deblurring.parameter_of(cell.method),
        "seconds": seconds,
    }


def _score(image: deblurring.Picture, seen: Seen, part: str, strength: float | None) -> Row:
    score = picture_score(image, seen.scene.sharp, seen.parts[part])
    return {
        "psnr_db": round(score.psnr_db, 3),
        "ssim": round(score.ssim, 4),
        "pixels": score.pixels,
        "strength": strength,
    }


def _ringing(image: deblurring.Picture, seen: Seen) -> float:
    return round(overshoot(image, seen.scene.sharp, seen.parts["near"]), 4)


# A process works through its cells in order of views.
@lru_cache(maxsize=2)
def _seen(view: View) -> Seen:
    (scene,) = RayTracedScene.load_views(view.folder, view.mask, 1)
    bank = CameraBank.of_scene(scene.camera, scene.depth_m, view.levels)
    random = np.random.default_rng(view.seed)
    noise = np.float32(view.noise) * random.standard_normal(scene.coded.shape, dtype=np.float32)
    coded = scene.coded + noise
    maps = {deblurring.TRUE: np.asarray(scene.camera.blur_size_px(scene.depth_m), np.float32)}
    for name, config in (
        (deblurring.ESTIMATED, DepthConfig()),
        (deblurring.CLASSICAL, DepthConfig(regularize="semiglobal")),
    ):
        maps[name] = predict(coded, bank, config, scene.camera).blur_size_px
    away = scene.edge_distance_px() > _NEAR_EDGE_PX
    return Seen(
        scene=scene,
        coded=coded,
        stack=bank.learn().stack,
        blur_size_px=maps,
        parts={"all": np.ones(away.shape, bool), "near": ~away, "away": away},
    )


@lru_cache(maxsize=1)
def _practice(view: View) -> deblurring.Practice:
    """Return other pictures in front of the same camera, at the same depths."""
    seen = _seen(view)
    shape = seen.coded.shape[:2]
    down, across = (-(-side // _PATCH_PX) for side in shape)
    rows, width = -(-shape[0] // down), -(-shape[1] // across)
    random = np.random.default_rng([deblurring.PRACTICE_SEED, view.seed])
    patches = training_textures().crops(down * across, rows, width, random)
    patchwork = patches.reshape(down, across, rows, width).swapaxes(1, 2)
    sharp = decode(patchwork.reshape(down * rows, -1)[: shape[0], : shape[1]], SRGB)
    sharp = np.asarray(sharp, np.float32)
    coded = render_coded_frame(
        sharp, seen.scene.depth_m, seen.scene.camera, aperture_blocks=_APERTURE_BLOCKS
    )
    coded += np.float32(view.noise) * random.standard_normal(coded.shape, dtype=np.float32)
    level = deblurring.nearest_level(seen.blur_size_px[deblurring.TRUE], seen.stack)
    return deblurring.Practice(coded, sharp, level, seen.stack)


def _mean_square(
    image: deblurring.Picture, truth: deblurring.Picture, part: NDArray[np.bool_]
) -> float:
    """Return that of a part of the pixels; 0 where the scene has no such part."""
    return float(((image - truth)[part] ** 2).mean()) if part.any() else 0.0


def _results(args: options.Args, measured: list[Measured]) -> Row:
    rows = [
        row
        for view in dict.fromkeys(cell.view for cell in measured)
        for row in _with_gains([cell for cell in measured if cell.view == view])
    ]
    return {
        "near_edge_px": _NEAR_EDGE_PX,
        "cells": rows,
        "references_ahead": {part: _ahead(rows, part) for part in _PARTS},
    }


def _with_gains(measured: Sequence[Measured]) -> list[Row]:
    """Return the rows of a view: first the coded frame's own, then what is gained on it."""
    coded = measured[0].rows[0]
    rows = [row for cell in measured for row in cell.rows]
    for row, part in itertools.product(rows, _PARTS):
        for score in ("psnr_db", "ssim"):
            row[part][f"{score}_gain"] = round(row[part][score] - coded[part][score], 4)
    return rows


def _ahead(rows: Sequence[Row], part: str) -> list[Row]:
    return deblurring.ahead(rows, ("scene", "mask", "depth"), lambda row: -row[part]["psnr_db"])


def _text(results: Row) -> str:
    rows, found = results["cells"], results["references_ahead"]
    described: dict[str, Any] = {
        "method": "{method}",
        "depth": lambda row: row["depth"] or "-",
        **{title: partial(_score_text, part=part) for part, title in _PARTS.items()},
        "overshoot": lambda row: f"{100 * row['overshoot']:.1f} %",
        "within std dev": lambda row: or_dash(_within(row), "{:.0%}"),
        "rms error filled / uncertain / seen": _by_kind,
        "time": lambda row: or_dash(row["seconds"], "{:.1f} s"),
    }
    parts = [
        tables(
            "peak signal-to-noise ratio in dB (gain on the coded frame) / structural similarity "
            "(gain)",
            rows,
            ("scene", "mask"),
            "{scene}, mask {mask}",
            lambda here: columns(here, described),
        )
    ]
    cells = deblurring.compared_cells(rows)
    if cells is not None:
        parts += [
            f"{title}, by signal-to-noise ratio: {deblurring.ahead_text(found[part], cells)}"
            for part, title in _PARTS.items()
        ]
    return "\n\n".join(parts)


def _within(row: Row) -> float | None:
    within: float | None = row.get("uncertainty", {}).get("within_std_dev")
    return within


def _by_kind(row: Row) -> str:
    kinds = [row["uncertainty"][kind] for kind in _KINDS] if _within(row) is not None else []
    texts = [f"{or_dash(kind['rms_error'], '{:.4f}')} ({kind['share']:.0%})" for kind in kinds]
    return " / ".join(texts) or "-"


def _score_text(row: Row, part: str) -> str:
    form = "{psnr_db:.2f} ({psnr_db_gain:+.2f}) / {ssim:.3f} ({ssim_gain:+.3f})"
    return form.format_map(row[part])


def _draw(_: options.Args, measured: list[Measured], folder: Path) -> None:
    """Write a picture for every view and depth: the frames, and parts of them enlarged."""
    for view in dict.fromkeys(cell.view for cell in measured):
        seen = _seen(view)
        here = [cell for cell in measured if cell.view == view and cell.sharp]
        crops = _telling_crops(seen)
        for index, depth in enumerate(seen.blur_size_px):
            frames = [("coded", seen.coded), ("truth", seen.scene.sharp)]
            for cell in here:
                row = cell.rows[index]
                title = f"{row['method']} {row['all']['psnr_db_gain']:+.2f} dB"
                frames.append((title, cell.sharp[depth]))
            shown = [(title, _shown(frame, crops)) for title, frame in frames]
            write_image(folder / f"{view.name}_{view.mask}_{depth}.png", side_by_side(shown))


def _shown(frame: deblurring.Picture, crops: Sequence[Place]) -> list[NDArray[np.uint8]]:
    """Return the whole frame, and its crops enlarged to the same width."""
    whole = of_width(as_rgb(frame, SRGB), _ENLARGED * _CROP_PX)
    return [whole, *(enlarged(as_rgb(frame[crop], SRGB), _ENLARGED) for crop in crops)]


def _telling_crops(seen: Seen) -> list[Place]:
    """Return the most textured place with a depth edge, and the most textured one without."""
    grey = seen.scene.sharp.mean(axis=2)
    places = [
        (slice(top, top + _CROP_PX), slice(left, left + _CROP_PX))
        for top in range(0, max(grey.shape[0] - _CROP_PX, 0) + 1, _CROP_PX // 2)
        for left in range(0, max(grey.shape[1] - _CROP_PX, 0) + 1, _CROP_PX // 2)
    ]

    def texture(place: Place) -> float:
        part = grey[place]
        return float(sum(np.mean(np.diff(part, axis=axis) ** 2) for axis in (0, 1)))

    away = [float(np.mean(seen.parts["away"][place])) for place in places]
    with_edge = [place for place, share in zip(places, away, strict=True) if share < 0.7]
    without = [place for place, share in zip(places, away, strict=True) if share > 0.9]
    return [max(group, key=texture) for group in (with_edge, without) if group]


SUITE = Suite(
    name="deblur scenes",
    said=("noise", "levels", "seed"),
    description="Peak signal-to-noise ratio and structural similarity of the all-in-focus frames "
    "of ray-traced scenes, in linear light, and what they gain on the coded frame: by the true "
    "depth, by the depth that is estimated from the same frame, and by that without refinement. "
    "Overshoot: how far the picture goes beyond the true one's range within 12 px, mean of the "
    "worst hundredth of the pixels near depth edges, relative to that range.",
    examples="""examples:
  two scenes, all methods, with pictures:
    coded_aperture bench deblur scenes desk/ corridor/ --output results/
  another mask that the scene was rendered with, one method, more noise:
    coded_aperture bench deblur scenes desk/ --masks four_hole --methods fast --noise 0.01
a scene's folder has:
  meta.json (camera and masks), depth_0.1mm.png, aif_linear.png, coded_MASK_linear.png
  or, for a video, whose first frame is used, depth_NNN.png, aif_NNN.png, coded_MASK_NNN.png
""",
    options=(
        options.folders("a scene"),
        options.SCENE_MASKS,
        options.added_noise(0.002),
        options.number("--levels", 2, 30, "blur levels of the bank"),
        *deblurring.METHOD_OPTIONS,
        *options.DEPTH_RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
