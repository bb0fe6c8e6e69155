"""`coded_aperture mask design`: which mask for a camera, a range and some light, end to end."""

import argparse
import dataclasses
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.figures import masks_by_light
from coded_aperture_benchmarks.layered import LayeredScene, random_scene
from coded_aperture_benchmarks.mask_scores.spectra import SceneConfig
from coded_aperture_benchmarks.mask_search.grids import CARRIERS
from coded_aperture_benchmarks.mask_search.search import (
    Front,
    SearchConfig,
    not_beaten,
    run_epoch,
    search_epochs,
)
from coded_aperture_benchmarks.metrics.edges import edge_distance_px
from coded_aperture_benchmarks.rows import columns, grouped, mean_of
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_ros.cli.options import at_least, mask_of, written_name
from coded_aperture_ros.cli.progress import progress
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.design.diffraction import airy_width_px
from coded_aperture_ros.design.openings import mask_openings, mask_outlines, narrowest_bar, recut
from coded_aperture_ros.design.setting import resolutions_m
from coded_aperture_ros.design.sheet import mask_sheet
from coded_aperture_ros.design.sheet_files import sheet_svg
from coded_aperture_ros.io import write_image
from coded_aperture_ros.likelihood.bank import FilterBank, learn_bank_for_camera
from coded_aperture_ros.likelihood.bank.learning import guarded_range
from coded_aperture_ros.optics import Camera, Mask, load_camera
from coded_aperture_ros.simulation import SensorModel

_SIZE = (288, 384)
_NAMED = ("levin", "zhou", "four_hole", "four_wide", "three_wide")
_FOUND = "found"
# Scenes to choose by, and others, to say what was chosen is worth.
_CHOOSE, _UNSEEN = "to choose by", "unseen"
_FIRST_SCENE = {_CHOOSE: 3_000_000, _UNSEEN: 3_500_000}
_NEAR_EDGES_PX, _RIGHT = 16, 0.1
# Photons on a square metre in a second, of white light of one lux; what lenses let pass, and what
# sensors count.
_PHOTONS_OF_LUX, _LENS, _EFFICIENCY = 1e16, 0.85, 0.6
# Points of the aperture along a side, or some more.
_POINTS = 44
# One pixel in so many, for medians over all scenes.
_THINNED = 7
_PUBLISHED = DepthConfig().confidence_threshold


@dataclasses.dataclass(frozen=True)
class Light:
    """How much light there is, and what the sensor makes of it."""

    illuminance_lux: float
    exposure_ms: float
    full_well: float  # electrons
    read_noise: float  # electrons

    def electrons(self, camera: Camera) -> float:
        """Return how many electrons a white surface makes in a pixel, at most a full well.

        That is `E t M^2 o / (pi f^2)` for a Lambertian surface, with the focal length in pixels: a
        pixel's area over the square of the focal length needs no pixel pitch.
        """
        area_m2 = camera.mask.open_fraction * (1e-3 * camera.mask_extent_mm) ** 2
        passed = _LENS * self.illuminance_lux * area_m2 / (np.pi * camera.focal_length_px**2)
        made = _EFFICIENCY * _PHOTONS_OF_LUX * passed * 1e-3 * self.exposure_ms
        return float(min(made, self.full_well))

    def exposed(self, light: FloatArray, camera: Camera, random: np.random.Generator) -> FloatArray:
        """Return the frame, with shot and read noise, white at 1 and in 12 bits."""
        white = self.electrons(camera)
        counted = random.poisson(np.clip(light, 0, None) * white)
        noise = random.normal(0, self.read_noise, counted.shape)
        return SensorModel(bits=12).expose((counted + noise) / white, random)


@dataclasses.dataclass(frozen=True)
class Cell:
    """A mask before a scene, of those that choose or of those that do not."""

    camera: Camera
    range_m: tuple[float, float]
    levels: int
    light: Light
    part: str
    number: int
    cut_mm: float


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """The relative errors of some pixels, NaN where unknown, as the mask is and cut too wide."""

    cell: Cell
    errors: FloatArray  # [n]
    near_edges: FloatArray  # [m]
    cut_wide: FloatArray  # [n]
    published: float
    right_of_published: float


def _cells(args: argparse.Namespace) -> list[Cell]:
    camera, (near_m, far_m) = load_camera(args.camera), args.depth_range
    if camera.side == "both":
        raise InputError(
            f"{args.camera}: side: both is not designed for: choose the side of the focal plane"
        )
    blur_px = camera.blur_range_px(near_m, far_m)
    for name in ("illuminance_lux", "exposure_ms", "full_well", "read_noise", "cut_mm"):
        least = 0 if name in ("read_noise", "cut_mm") else 1e-9
        if not getattr(args, name) >= least:
            args.usage_error(
                f"{written_name(name)}: expected {'0 or ' if not least else ''}more than 0"
            )
    light = Light(args.illuminance_lux, args.exposure_ms, args.full_well, args.read_noise)
    masks = [mask_of(name) for name in dict.fromkeys(args.masks)]
    masks += _searched(args, sorted(abs(size) for size in blur_px))
    names = [mask.name for mask in masks]
    for mask in masks:
        if names.count(mask.name) > 1:
            raise InputError(f"mask {mask.name}: another one has this name too")
        mask_outlines(mask)  # refuses what cannot be cut
    # The frames have the noise of this light, and no other errors of a lens.
    camera = dataclasses.replace(
        camera, noise=0.0, noise_gain=0.0, field_curvature=None, diffraction=None
    )
    cameras = [dataclasses.replace(camera, mask=mask) for mask in masks]
    for one in cameras:
        guarded_range(one, near_m, far_m, args.levels)
    return [
        Cell(one, (near_m, far_m), args.levels, light, part, number, args.cut_mm)
        for one in cameras
        for part, count in ((_CHOOSE, args.scenes), (_UNSEEN, args.unseen))
        for number in range(count)
    ]


def _searched(args: argparse.Namespace, blur_px: Sequence[float]) -> list[Mask]:
    """Return the masks that are predicted to be good, of some hundred thousand."""
    if not args.rounds:
        return []
    config = SearchConfig(
        cells=args.cells,
        smallest_opening=args.smallest_opening,
        carrier=args.carrier,
        epochs=args.rounds,
        islands=1,
        least_light=0.25,
        seed=args.seed,
    )
    smallest, largest = max(blur_px[0], 0.5), min(blur_px[1], 60.0)
    scene = SceneConfig(levels=args.levels, smallest_px=smallest, largest_px=largest)
    front = Front.empty(args.cells)
    run_all = partial(map, lambda task: run_epoch(*task))
    for state in progress(search_epochs(config, scene, run_all), args.rounds, "round"):
        front = state.front
    # From the least depth error to the most light, in equal steps.
    grids = front.grids[not_beaten(front.scores[:, [0, 2]])]
    chosen = np.unique(np.linspace(0, len(grids) - 1, args.found).round().astype(int))
    return [
        Mask(f"{_FOUND}_{place}", grids[index].astype(np.float32))
        for place, index in enumerate(chosen, 1)
    ]


def measure(cell: Cell) -> Measured:
    """Take a frame of the scene through the mask, and compare its depth with the truth."""
    scene = _scene(cell.camera.side, cell.part, cell.number, _blur_range_px(cell))
    blur_px = scene.blur_size_px()
    true_m = np.asarray(cell.camera.depth_m(blur_px), np.float32)
    edges = edge_distance_px(blur_px) <= _NEAR_EDGES_PX
    mask = cell.camera.mask
    found = _errors(cell, mask, scene, true_m)
    share = cell.cut_mm / cell.camera.mask_extent_mm
    wide = _errors(cell, recut(mask, share) if share else mask, scene, true_m)
    sure = found[1] >= _PUBLISHED
    right = np.abs(found[0][sure]) <= _RIGHT
    return Measured(
        cell,
        found[0].ravel()[::_THINNED],
        found[0][edges][::_THINNED],
        wide[0].ravel()[::_THINNED],
        float(sure.mean()),
        float(right.mean()) if sure.any() else np.nan,
    )


def _errors(
    cell: Cell, cut: Mask, scene: LayeredScene, true_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return relative error and confidence of every pixel, through a mask as it was cut."""
    camera = cell.camera
    random = np.random.default_rng([cell.number, len(cell.part)])
    # As it is and cut wide it is averaged over the same points, each within a cell of the mask.
    cells = max(camera.mask.transmission.shape)
    fewest = cells * -(-_POINTS // cells) if cells <= _POINTS else _POINTS
    frame = cell.light.exposed(scene.coded(cut, fewest), camera, random)
    config = DepthConfig(confidence_threshold=0.0)
    estimator = DepthEstimator(_bank(camera, cell.range_m, cell.levels), config, camera)
    estimate = estimator.estimate(frame)
    estimator.close()
    assert estimate.depth_m is not None
    relative = np.abs(estimate.depth_m / true_m - 1)
    return np.where(np.isfinite(true_m), relative, np.nan), estimate.confidence


def _blur_range_px(cell: Cell) -> tuple[float, float]:
    return cell.camera.blur_range_px(*cell.range_m)


@lru_cache(maxsize=64)
def _scene(side: str, part: str, number: int, blur_px: tuple[float, float]) -> LayeredScene:
    """Return a scene of the camera's blur sizes; the same behind every mask of one extent."""
    return random_scene(_FIRST_SCENE[part] + number, Mask.named("levin"), side, _SIZE, blur_px)


@lru_cache(maxsize=2)
def _bank(camera: Camera, range_m: tuple[float, float], levels: int) -> FilterBank:
    return learn_bank_for_camera(camera, *guarded_range(camera, *range_m, levels))


def _results(args: argparse.Namespace, measured: list[Measured], seconds: float) -> Row:
    of_mask = grouped(
        [{"mask": each.cell.camera.mask.name, "measured": each} for each in measured], "mask"
    )
    rows = [_row([row["measured"] for row in group]) for group in of_mask.values()]
    scores = np.array([[row[_CHOOSE]["error"], -row["electrons"]] for row in rows])
    for row, best in zip(rows, not_beaten(scores), strict=True):
        row["not_beaten"] = bool(best)
    rows.sort(key=lambda row: row[_CHOOSE]["error"])
    camera = measured[0].cell.camera
    return {
        "benchmark": "design",
        **options.header(args, "depth_range", "illuminance_lux", "exposure_ms", "scenes", "unseen"),
        "resolutions_m": {
            where: [round(value, 4) for value in at]
            for where, at in resolutions_m(camera, *args.depth_range).items()
        },
        "cut_mm": args.cut_mm,
        "seconds": seconds,
        "chosen": rows[0]["mask"],
        "against_first": _against(rows, args.masks[0]),
        "masks": rows,
    }


def _row(measured: Sequence[Measured]) -> Row:
    camera, light = measured[0].cell.camera, measured[0].cell.light
    mask, openings = camera.mask, mask_openings(camera.mask)
    extent_mm = camera.mask_extent_mm
    bar_mm = extent_mm * narrowest_bar(mask)
    return {
        "mask": mask.name,
        "light": round(mask.open_fraction, 3),
        "electrons": round(light.electrons(camera)),
        "opening_mm": round(extent_mm * openings.smallest_width, 3),
        "bar_mm": round(bar_mm, 3) if np.isfinite(bar_mm) else None,
        "loose_parts": openings.loose_parts,
        "airy_px": round(max(airy_width_px(camera, one) for one in openings.each), 2),
        **{
            part: _pooled([one for one in measured if one.cell.part == part])
            for part in dict.fromkeys(one.cell.part for one in measured)
        },
        "rows": ["".join("#" if cell > 0.5 else "." for cell in row) for row in mask.transmission]
        if max(mask.transmission.shape) <= 16
        else None,
    }


def _pooled(measured: Sequence[Measured]) -> Row:
    """Return errors over all scenes; what is not known counts as wrong."""
    right = [one.right_of_published for one in measured if np.isfinite(one.right_of_published)]
    every, edges, wide = (
        np.concatenate([getattr(one, name) for one in measured])
        for name in ("errors", "near_edges", "cut_wide")
    )
    return {
        "error": round(float(np.nanmedian(every)), 4),
        "right": round(float((every <= _RIGHT).mean()), 3),
        "right_near_edges": round(float((edges <= _RIGHT).mean()), 3),
        "cut_wide": round(float(np.nanmedian(wide)), 4),
        "published": mean_of((one.published for one in measured), 3),
        "right_of_published": mean_of(right, 3) if right else None,
        "worst": round(max(float(np.nanmedian(one.errors)) for one in measured), 4),
    }


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def _against(rows: Sequence[Row], first: str) -> Row:
    """Compare the chosen mask with the first one that was named, on scenes of both parts."""
    by_name = {row["mask"]: row for row in rows}
    other = by_name[first if first in by_name else Path(first).name]
    return {
        "mask": other["mask"],
        **{
            part: round(1 - rows[0][part]["error"] / other[part]["error"], 3)
            for part in _FIRST_SCENE
            if part in rows[0]
        },
    }


def _text(results: Row) -> str:
    part = _UNSEEN if results["unseen"] else _CHOOSE
    shown = {
        "mask": lambda row: row["mask"] + (" *" if row["not_beaten"] else ""),
        "light": "{light:.2f}",
        "electrons": "{electrons}",
        "error, to choose by": lambda row: f"{100 * row[_CHOOSE]['error']:.2f} %",
        f"{part}": lambda row: f"{100 * row[part]['error']:.2f} %",
        "worst scene": lambda row: f"{100 * row[part]['worst']:.1f} %",
        "within 10 %": lambda row: f"{100 * row[part]['right']:.0f} %",
        "near edges": lambda row: f"{100 * row[part]['right_near_edges']:.0f} %",
        "published": lambda row: f"{100 * row[part]['published']:.0f} %",
        "right of these": lambda row: _share(row[part]["right_of_published"]),
        "cut wide": lambda row: f"{100 * row[part]['cut_wide']:.2f} %",
        "opening, mm": "{opening_mm:.2f}",
        "bar, mm": lambda row: "-" if row["bar_mm"] is None else f"{row['bar_mm']:.2f}",
        "Airy, px": "{airy_px:.1f}",
    }
    resolved = ", ".join(
        f"{1e3 * step:.1f} mm at {depth:.2f} m" for depth, step in results["resolutions_m"].values()
    )
    near, far = results["depth_range"]
    other = results["against_first"]
    gains = ", ".join(
        f"{100 * other[name]:.0f} % less error than {other['mask']} on scenes {what}"
        for name, what in ((_CHOOSE, "to choose by"), (_UNSEEN, "that it was not chosen by"))
        if name in other
    )
    return "\n".join(
        [
            f"{near:g} to {far:g} m, {results['illuminance_lux']:g} lux, "
            f"{results['exposure_ms']:g} ms; a pixel of blur is {resolved}",
            f"median error of all pixels; * is not beaten in error and light; cut wide: the same "
            f"with openings {results['cut_mm']:g} mm wider than they should be",
            columns(results["masks"], shown),
            f"chosen: {results['chosen']}, {gains}",
        ]
    )


def _draw(args: options.Args, measured: list[Measured], folder: Path) -> None:
    results = _results(args, measured, 0.0)
    masks = {each.cell.camera.mask.name: each.cell.camera for each in measured}
    part = _UNSEEN if args.unseen else _CHOOSE
    masks_by_light(
        [(masks[row["mask"]].mask, row["light"], row[part]["error"]) for row in results["masks"]],
        folder / "pareto.png",
    )
    for row in results["masks"]:
        if row["not_beaten"]:
            camera = masks[row["mask"]]
            write_image(folder / f"{row['mask']}.png", camera.mask.transmission)
            sheet = mask_sheet(camera.mask, camera.mask_extent_mm)
            with atomic_output(folder / f"{row['mask']}.svg") as path:
                path.write_text(sheet_svg(sheet))


SUITE = Suite(
    description="Compare masks for a camera, a depth range and some light, end to end: random "
    "scenes of the camera's blur sizes are traced through each mask, exposed with shot and read "
    "noise but without diffraction, and their depth is estimated with defaults. Named masks, "
    "files, and those that a search finds. Some scenes choose, others say what that is worth.",
    examples="""examples:
  a mask for half a metre to four metres in a room (some minutes), with pictures and cut files:
    coded_aperture mask design --camera camera.yaml --depth-range 0.5 4 --illuminance-lux 200 \\
        --output design/
  masks of your own beside Levin's, without a search:
    coded_aperture mask design --camera camera.yaml --depth-range 0.5 4 --illuminance-lux 200 \\
        --masks levin mine.png --rounds 0
""",
    options=(
        options.option("--camera", "camera file", metavar="YAML", required=True),
        options.option(
            "--depth-range", "m", nargs=2, type=float, metavar=("NEAR", "FAR"), required=True
        ),
        options.option(
            "--illuminance-lux",
            "light on the scene: a dim room has 50, an office 300, a cloudy day 10,000",
            200.0,
            type=float,
            metavar="E",
        ),
        options.option("--exposure-ms", "time of exposure", 10.0, type=float, metavar="T"),
        options.option(
            "--full-well", "electrons that a pixel holds", 10_000.0, type=float, metavar="N"
        ),
        options.option("--read-noise", "of the sensor, electrons", 3.0, type=float, metavar="N"),
        options.masks(*_NAMED),
        options.number("--found", 1, 6, "how many of the masks that are found are tried"),
        options.option("--rounds", "of the search; 0: none", 4, type=at_least(0), metavar="N"),
        options.number("--cells", 7, 11, "along a side of the masks that are looked for"),
        options.number("--smallest-opening", 1, 1, "cells along a side of the smallest opening"),
        options.option(
            "--carrier",
            "what holds closed cells: film, or they hang together",
            "transparent",
            choices=CARRIERS,
        ),
        options.number("--scenes", 1, 8, "to choose by"),
        options.option(
            "--unseen", "scenes that nothing is chosen by", 16, type=at_least(0), metavar="N"
        ),
        options.option(
            "--cut-mm", "how much wider openings may be cut", 0.05, type=float, metavar="MM"
        ),
        options.number("--levels", 8, 30, "of the banks"),
        options.number("--seed", 0, 0, "of the search"),
        *options.RESULTS,
    ),
    cells=_cells,
    measure=measure,
    results=_results,
    text=_text,
    draw=_draw,
)
