"""`coded_aperture mask design`: which mask for a camera, a range and some light, end to end."""

import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.command import Command, argument
from coded_aperture_ros.cli.results_folder import RESULTS, check_results_folder, write_results
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.core.processes import map_in_processes
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.design.mask_figures import draw_masks_by_light
from coded_aperture_ros.design.search.search import SearchConfig
from coded_aperture_ros.design.setting import resolutions_m
from coded_aperture_ros.design.sheet import mask_sheet
from coded_aperture_ros.design.sheet_files import sheet_svg
from coded_aperture_ros.design.trials import (
    CHOOSE,
    PARTS,
    UNSEEN,
    Trial,
    masks_in_order,
    measure,
    searched_masks,
    trials_of,
)
from coded_aperture_ros.io import write_image
from coded_aperture_ros.optics import Camera, Mask, load_camera, load_mask
from coded_aperture_ros.simulation.exposure import Exposure

_EXAMPLES = """examples:
  a mask for half a metre to four metres in a room (some minutes), with pictures and cut files:
    coded_aperture mask design --camera camera.yaml --depth-range 0.5 4 --illuminance-lux 200 \\
        --output design/
  masks of your own beside Levin's, without a search:
    coded_aperture mask design --camera camera.yaml --depth-range 0.5 4 --illuminance-lux 200 \\
        --masks levin mine.png --rounds 0
"""
_NAMED = ("levin", "zhou", "four_hole", "four_wide", "three_wide")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments:
    """Arguments of `mask design`."""

    camera: str = argument("camera file", written="--camera YAML")
    depth_range: tuple[float, float] = argument("m", written="--depth-range NEAR FAR")
    illuminance_lux: float = argument(
        "light on the scene: a dim room has 50, an office 300, a cloudy day 10,000",
        200.0,
        written="--illuminance-lux E",
        above=0,
    )
    exposure_ms: float = argument("time of exposure", 10.0, written="--exposure-ms T", above=0)
    full_well: float = argument(
        "electrons that a pixel holds", 10_000.0, written="--full-well N", above=0
    )
    read_noise: float = argument(
        "of the sensor, electrons", 3.0, written="--read-noise N", minimum=0
    )
    masks: tuple[str, ...] = argument(
        f"names or files (default {' '.join(_NAMED)})", _NAMED, written="--masks MASK"
    )
    found: int = argument(
        "how many of the masks that are found are tried", 6, written="--found N", minimum=1
    )
    rounds: int = argument("of the search; 0: none", 4, written="--rounds N", minimum=0)
    cells: int = argument(
        "along a side of the masks that are looked for", 11, written="--cells N", minimum=7
    )
    smallest_opening: int = argument(
        "cells along a side of the smallest opening", 1, written="--smallest-opening N", minimum=1
    )
    carrier: str = argument(
        "what holds closed cells: film, or they hang together",
        "transparent",
        choices=("transparent", "connected"),
    )
    scenes: int = argument("to choose by", 8, written="--scenes N", minimum=1)
    unseen: int = argument("scenes that nothing is chosen by", 16, written="--unseen N", minimum=0)
    cut_mm: float = argument(
        "how much wider openings may be cut", 0.05, written="--cut-mm MM", unit="mm", minimum=0
    )
    levels: int = argument("of the banks", 30, written="--levels N", minimum=8)
    seed: int = argument("of the search", 0, written="--seed N", minimum=0)
    jobs: int = argument(
        "processes (default: one for each processor)", processors(), written="--jobs N", minimum=1
    )
    json: bool = argument("print the results as JSON", False)
    output: Path | None = argument(
        f"write {RESULTS} and figures (PNG)", None, written="--output DIR"
    )


def run(args: Arguments) -> int:
    """Run the action; return its exit status."""
    trials = _trials(args)
    check_results_folder(args.output)
    start = time.perf_counter()
    measured = map_in_processes(measure, trials, args.jobs, "trial")
    seconds = round(time.perf_counter() - start, 1)
    rows = masks_in_order(measured)
    cameras = {trial.camera.mask.name: trial.camera for trial in trials}
    results = _results(args, rows, trials[0].camera, seconds)
    return write_results(
        results,
        _text,
        lambda folder: _draw(args, rows, cameras, folder),
        args.output,
        as_json=args.json,
    )


def _trials(args: Arguments) -> list[Trial]:
    camera = load_camera(args.camera)
    if camera.side == "both":
        raise InputError(
            f"{args.camera}: side: both is not designed for: choose the side of the focal plane"
        )
    near_m, far_m = args.depth_range
    blur_px = camera.blur_range_px(near_m, far_m)
    light = Exposure(args.illuminance_lux, args.exposure_ms, args.full_well, args.read_noise)
    masks = [load_mask(name) for name in dict.fromkeys(args.masks)]
    if args.rounds:
        masks += _searched(args, sorted(abs(size) for size in blur_px))
    scenes = args.scenes, args.unseen
    return trials_of(camera, masks, (near_m, far_m), args.levels, light, scenes, args.cut_mm)


def _searched(args: Arguments, blur_px: Sequence[float]) -> list[Mask]:
    config = SearchConfig(
        cells=args.cells,
        smallest_opening=args.smallest_opening,
        carrier=args.carrier,
        epochs=args.rounds,
        islands=1,
        least_light=0.25,
        seed=args.seed,
    )
    return searched_masks(
        config,
        args.levels,
        blur_px,
        args.found,
        lambda steps: progress(steps, args.rounds, "round"),
    )


def _results(
    args: Arguments, rows: list[dict[str, Any]], camera: Camera, seconds: float
) -> dict[str, Any]:
    asked = ("depth_range", "illuminance_lux", "exposure_ms", "scenes", "unseen")
    return {
        "benchmark": "design",
        **{name: getattr(args, name) for name in asked},
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


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def _against(rows: Sequence[dict[str, Any]], first: str) -> dict[str, Any]:
    """Compare the chosen mask with the first one that was named, on scenes of both parts."""
    by_name = {row["mask"]: row for row in rows}
    other = by_name[first if first in by_name else Path(first).name]
    return {
        "mask": other["mask"],
        **{
            part: round(1 - rows[0][part]["error"] / other[part]["error"], 3)
            for part in PARTS
            if part in rows[0]
        },
    }


def _text(results: dict[str, Any]) -> str:
    part = UNSEEN if results["unseen"] else CHOOSE
    shown = {
        "mask": lambda row: row["mask"] + (" *" if row["not_beaten"] else ""),
        "light": "{light:.2f}",
        "electrons": "{electrons}",
        "error, to choose by": lambda row: f"{100 * row[CHOOSE]['error']:.2f} %",
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
        for name, what in ((CHOOSE, "to choose by"), (UNSEEN, "that it was not chosen by"))
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


def _draw(
    args: Arguments, rows: list[dict[str, Any]], cameras: Mapping[str, Camera], folder: Path
) -> None:
    """Draw all masks by light and error, and write pictures and cut files of those not beaten."""
    part = UNSEEN if args.unseen else CHOOSE
    draw_masks_by_light(
        [(cameras[row["mask"]].mask, row["light"], row[part]["error"]) for row in rows],
        folder / "pareto.png",
    )
    for row in rows:
        if row["not_beaten"]:
            camera = cameras[row["mask"]]
            write_image(folder / f"{row['mask']}.png", camera.mask.transmission)
            sheet = mask_sheet(camera.mask, camera.mask_extent_mm)
            with atomic_output(folder / f"{row['mask']}.svg") as path:
                path.write_text(sheet_svg(sheet))


COMMAND = Command(
    Arguments,
    run,
    description="Compare masks for a camera, a depth range and some light, end to end: random "
    "scenes of the camera's blur sizes are traced through each mask, exposed with shot and "
    "read noise but without diffraction, and their depth is estimated with defaults. Named "
    "masks, files, and those that a search finds. Some scenes choose, others say what that is "
    "worth.",
    examples=_EXAMPLES,
)
