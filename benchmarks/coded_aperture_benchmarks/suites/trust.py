"""Frames that do not fit their bank."""

import dataclasses
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.datasets.fitting_frames import (
    FITTING_LIGHT,
    Change,
    Fitting,
    Recorded,
    recorded,
)
from coded_aperture_benchmarks.datasets.misfits import LIGHT, MISFITS
from coded_aperture_benchmarks.datasets.ray_traced import RayTracedScene
from coded_aperture_benchmarks.methods.depth import RANGE_MARGIN, StackBank, predict
from coded_aperture_benchmarks.metrics.relative import COVERED, WRONG, published
from coded_aperture_benchmarks.rows import mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.suites.deblur_photograph import photograph
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.deblur import DeblurConfig, Deblurrer
from coded_aperture_ros.depth import DepthConfig, DepthEstimate
from coded_aperture_ros.likelihood.bank import LearnConfig
from coded_aperture_ros.likelihood.bank.for_camera import psf_stack_for_camera
from coded_aperture_ros.metrics import Reliability
from coded_aperture_ros.optics import Mask, PsfStack, render_psf
from coded_aperture_ros.simulation.render import render_coded_frame

_LEVELS, _WINDOW_PX, _NOISE = 30, 48, 0.002
_RIGHT = 0.05
_FITS = "fits"
_STRENGTHS = (0.0, 0.25, 0.5, 0.75, 1.0)
# A photograph's PSF is scaled to these sizes; its nominal one, and its own noise's twin.
_PHOTO_SIZES_PX, _PHOTO_PX, _PHOTO_NOISE = np.arange(6.0, 20.1, 0.5), 13.0, 0.0005
_PHOTO_WIDTH = 25
_HEADER = ["frames", "kind", "error, coverage, health", *[""] * (len(_STRENGTHS) - 1)]


@dataclasses.dataclass(frozen=True)
class Cell:
    """One kind of misfit of one scene or photograph."""

    folder: Path
    mask: str
    kind: str
    seed: int


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of a cell's strengths, for JSON, and how far confidence may be believed."""

    rows: list[Row]
    reliability: Reliability | None


def _cells(args: options.Args) -> list[Cell]:
    known = [*LIGHT, *MISFITS]
    kinds = known if args.kinds == [None] else args.kinds
    options.check_known(args, "kinds", kinds, known)
    frames = [(folder, mask) for folder in args.folders for mask in args.masks]
    frames += [(folder, "photograph") for folder in args.photographs if folder is not None]
    for folder, mask in frames:
        _fitting(folder, mask)
    return [
        Cell(folder, mask, kind, args.seed) for folder, mask in frames for kind in (_FITS, *kinds)
    ]


@lru_cache(maxsize=2)
def _fitting(folder: Path, mask: str) -> Fitting:
    return _of_photograph(folder) if mask == "photograph" else _of_scene(folder, mask)


def _of_scene(folder: Path, mask: str) -> Fitting:
    scene = RayTracedScene.load(folder, mask)
    camera, depth_m = scene.camera, np.where(scene.depth_m > 0, scene.depth_m, np.float32(np.nan))
    near_m, far_m = float(np.nanmin(depth_m)), float(np.nanmax(depth_m))
    stack = psf_stack_for_camera(
        camera, near_m * (1 - RANGE_MARGIN), far_m * (1 + RANGE_MARGIN), _LEVELS
    )
    filled_m = np.where(np.isfinite(depth_m), depth_m, np.nanmedian(depth_m))

    def ordinary(extent: float) -> FloatArray:
        lens = dataclasses.replace(
            camera, mask=Mask.named("disc"), mask_extent_mm=camera.mask_extent_mm * extent
        )
        return render_coded_frame(scene.sharp, filled_m, lens)

    size_px = np.asarray(camera.blur_size_px(depth_m), np.float32)
    return Fitting(scene.coded, lambda: scene.sharp, ordinary, stack, size_px, _NOISE)


def _of_photograph(folder: Path) -> Fitting:
    """Scale the photograph's PSF; its truth is the size that most of it has where it fits."""
    page = photograph(folder)
    psfs = [_scaled(page.psf, size / _PHOTO_PX) for size in _PHOTO_SIZES_PX]
    stack = PsfStack(_PHOTO_SIZES_PX, np.stack(psfs))
    found = predict(page.image, _bank(stack), DepthConfig(check_fit=False)).blur_size_px
    truth = np.full(page.image.shape, np.nanmedian(found), np.float32)
    sparse = Deblurrer(stack, DeblurConfig(method="sparse"))
    sharp = sparse.deblur(page.image, truth, _PHOTO_NOISE)

    def ordinary(extent: float) -> FloatArray:
        psf = render_psf(Mask.named("disc"), _PHOTO_PX * extent)
        return cv2.filter2D(sharp, -1, psf, borderType=cv2.BORDER_REFLECT)

    return Fitting(page.image, lambda: sharp, ordinary, stack, truth, _PHOTO_NOISE)


def _scaled(psf: FloatArray, scale: float) -> FloatArray:
    offset = (_PHOTO_WIDTH - 1) / 2 - scale * (len(psf) // 2)
    if scale < 1:
        psf = cv2.GaussianBlur(psf, (0, 0), max(0.3 * (1 / scale - 0.9), 0.15))
    move = np.array([[scale, 0, offset], [0, scale, offset]])
    scaled = cv2.warpAffine(psf, move, (_PHOTO_WIDTH, _PHOTO_WIDTH), flags=cv2.INTER_CUBIC)
    return np.asarray(np.maximum(scaled, 0) / np.maximum(scaled, 0).sum())


def measure(cell: Cell) -> Measured:
    """Measure one kind of misfit in all its strengths."""
    fitting = _fitting(cell.folder, cell.mask)
    rows, reliability = [], []
    for number, strength in enumerate(_STRENGTHS):
        random = np.random.default_rng([cell.seed, number])
        if cell.kind == _FITS:
            share, noise = FITTING_LIGHT[number]
            other = dataclasses.replace(fitting, noise=fitting.noise * noise)
            one: Recorded | None = recorded(other, fitting.light * share, random)
        else:
            one = _change_of(cell.kind)(fitting, strength, random)
        if one is None:
            continue
        config = DepthConfig(confidence_threshold=0.0, noise=one.known_noise)
        estimate = predict(one.frame, _bank(one.stack), config)
        error = _error(estimate, one)
        known = np.isfinite(error)
        right = error[known] <= _RIGHT
        reliability.append(Reliability.from_estimates(estimate.confidence[known], right))
        rows.append(_row(cell, strength, estimate, error))
    return Measured(rows, Reliability.total(reliability) if reliability else None)


def _change_of(kind: str) -> Change:
    return LIGHT[kind] if kind in LIGHT else MISFITS[kind].change


def _error(estimate: DepthEstimate, one: Recorded) -> FloatArray:
    """Return the relative error of depth, or of the blur size where there are no depths."""
    found, true = np.abs(estimate.blur_size_px), np.abs(one.blur_size_px)
    stack = one.stack
    if stack.depths_m is None:
        return np.abs(found / true - 1)
    # The inverse depth is linear in the blur size, beyond the levels, too.
    slope, at_focus = np.polyfit(np.abs(stack.blur_sizes_px), 1 / stack.depths_m, 1)
    inverse_true = slope * true + at_focus
    inverse_found = np.maximum(slope * found + at_focus, 1e-6)
    return np.asarray(np.abs(inverse_true / inverse_found - 1), np.float32)


def _row(cell: Cell, strength: float, estimate: DepthEstimate, error: FloatArray) -> Row:
    health = estimate.health
    misfit = MISFITS.get(cell.kind)
    return {
        "frames": f"{cell.folder.resolve().name}, {cell.mask}",
        "kind": cell.kind,
        "strength": strength,
        "traced": misfit is None or misfit.traced,
        **published(error, estimate.confidence, np.isfinite(error)),
        "health": None if health is None else round(health.value, 3),
        "cause": "" if health is None else health.cause,
        "cause_right": bool(health and misfit and health.cause in misfit.causes),
    }


@lru_cache(maxsize=1)
def _bank(stack: PsfStack) -> StackBank:
    return StackBank(stack, LearnConfig(window_px=_WINDOW_PX))


def _results(args: options.Args, measured: list[Measured]) -> Row:
    rows = [row for each in measured for row in each.rows]
    misfits = [row for row in rows if row["kind"] in MISFITS]
    traced = [row for row in misfits if row["traced"]]
    named = [row for row in traced if row["cause"]]
    reliability = Reliability.total(
        [
            each.reliability
            for each in measured
            if each.reliability is not None and each.rows[0]["traced"]
        ]
    )
    return {
        "cells": len(traced),
        "wrong": mean_of([row["wrong"] for row in traced] or [0], 4),
        "wrong_without_trace": mean_of(
            [row["wrong"] for row in misfits if not row["traced"]] or [0], 4
        ),
        "named": len(named),
        "cause_right": mean_of([row["cause_right"] for row in named] or [0], 4),
        "false_alarms": mean_of(
            [bool(row["cause"]) for row in rows if row["kind"] not in MISFITS], 4
        ),
        "expected_calibration_error": round(reliability.expected_calibration_error, 4),
        "rows": rows,
    }


def _text(results: Row) -> str:
    lines: dict[tuple[str, str], list[str]] = {}
    for row in results["rows"]:
        error = "-" if row["error"] is None else f"{100 * row['error']:.0f} %"
        health = "-" if row["health"] is None else f"{row['health']:.2f}"
        mark = "* " if row["wrong"] else ""
        text = f"{mark}{error}, {100 * row['coverage']:.0f} %, {health} {row['cause']}".rstrip()
        lines.setdefault((row["frames"], row["kind"]), []).append(text)
    cells = [
        [*names, *each, *[""] * (len(_STRENGTHS) - len(each))] for names, each in lines.items()
    ]
    return (
        f"{table(_HEADER, cells)}\n\n* published with a median error above {100 * WRONG:.0f} % at "
        f"a coverage above {100 * COVERED:.0f} %: {100 * results['wrong']:.1f} % of "
        f"{results['cells']} cells that leave a trace\ncause right: "
        f"{100 * results['cause_right']:.0f} % of {results['named']} named; fitting frames that "
        f"were not said to fit: {100 * results['false_alarms']:.1f} %; calibration error of the "
        f"confidence over all of these: {results['expected_calibration_error']:.3f}"
    )


SUITE = Suite(
    name="trust",
    said=("seed",),
    description="Measure what is made of frames that do not fit their bank: kinds of misfit in "
    f"{len(_STRENGTHS)} strengths, of rendered scenes and of a photograph of a flat page, whose "
    "truth is the blur size that most of it has where it fits. For each the median error of what "
    "has a confidence of 0.55 or more, how much of the frame that is, and the health of the frame "
    "with the likeliest cause. Same mask and another focus, and smaller frames, leave no trace in "
    "a frame: a bank that knows its camera refuses them.",
    examples="""examples:
  two scenes and a photograph:
    python -m coded_aperture_benchmarks trust desk/ chess/ --photographs real_photo/
  some kinds only:
    python -m coded_aperture_benchmarks trust desk/ --kinds "no mask" JPEG
""",
    options=(
        options.folders("scenes; see bench accuracy scenes"),
        options.SCENE_MASKS,
        options.option(
            "--photographs",
            "see bench deblur photograph",
            [None],
            said="",
            type=Path,
            metavar="FOLDER",
        ),
        options.option("--kinds", "of misfit (default: all)", [None], said="", metavar="KIND"),
        options.NOISE_SEED,
        *options.DEPTH_RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
)
