"""`coded_aperture mask design`: which mask for a camera, a range and some light, end to end."""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.options import add_jobs_option, add_options, written_name
from coded_aperture_ros.cli.results_folder import RESULTS, check_results_folder, write_results
from coded_aperture_ros.core.arguments import at_least
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.text import columns

_NAMED = ("levin", "zhou", "four_hole", "four_wide", "three_wide")
_EPILOG = """examples:
  a mask for half a metre to four metres in a room (some minutes), with pictures and cut files:
    coded_aperture mask design --camera camera.yaml --depth-range 0.5 4 --illuminance-lux 200 \\
        --output design/
  masks of your own beside Levin's, without a search:
    coded_aperture mask design --camera camera.yaml --depth-range 0.5 4 --illuminance-lux 200 \\
        --masks levin mine.png --rounds 0
"""


def add_parser(subparsers: Any) -> None:
    """Add the action to the sub-command's parser."""
    parser = subparsers.add_parser(
        "design",
        help="compare masks for a camera, a depth range and some light, from end to end",
        description="Compare masks for a camera, a depth range and some light, end to end: random "
        "scenes of the camera's blur sizes are traced through each mask, exposed with shot and "
        "read noise but without diffraction, and their depth is estimated with defaults. Named "
        "masks, files, and those that a search finds. Some scenes choose, others say what that is "
        "worth.",
        epilog=_EPILOG,
    )
    add_options(parser, {"--camera YAML": "camera file"}, required=True)
    add_options(parser, {"--depth-range NEAR FAR": "m"}, type=float, required=True)
    _add_light_options(parser)
    masks = f"names or files (default {' '.join(_NAMED)})"
    add_options(parser, {"--masks MASK": masks}, nargs="+", default=list(_NAMED))
    _add_search_options(parser)
    counts = {
        "--scenes N": (1, 8, "to choose by"),
        "--unseen N": (0, 16, "scenes that nothing is chosen by"),
    }
    _add_counts(parser, counts)
    cut = {"--cut-mm MM": "how much wider openings may be cut (default %(default)s)"}
    add_options(parser, cut, type=float, default=0.05)
    _add_counts(
        parser, {"--levels N": (8, 30, "of the banks"), "--seed N": (0, 0, "of the search")}
    )
    add_jobs_option(parser)
    results = {
        "--json": "print the results as JSON",
        "--output DIR": f"write {RESULTS} and figures (PNG)",
    }
    add_options(parser, results)


def _add_light_options(parser: argparse.ArgumentParser) -> None:
    values = {
        "--illuminance-lux E": (
            200.0,
            "light on the scene: a dim room has 50, an office 300, a cloudy day 10,000",
        ),
        "--exposure-ms T": (10.0, "time of exposure"),
        "--full-well N": (10_000.0, "electrons that a pixel holds"),
        "--read-noise N": (3.0, "of the sensor, electrons"),
    }
    for written, (default, what) in values.items():
        described = {written: f"{what} (default {default:g})"}
        add_options(parser, described, type=float, default=default)


def _add_search_options(parser: argparse.ArgumentParser) -> None:
    counts = {
        "--found N": (1, 6, "how many of the masks that are found are tried"),
        "--rounds N": (0, 4, "of the search; 0: none"),
        "--cells N": (7, 11, "along a side of the masks that are looked for"),
        "--smallest-opening N": (1, 1, "cells along a side of the smallest opening"),
    }
    _add_counts(parser, counts)
    holds = "what holds closed cells: film, or they hang together (default %(default)s)"
    add_options(parser, {"--carrier {transparent,connected}": holds})


def _add_counts(parser: argparse.ArgumentParser, counts: dict[str, tuple[int, int, str]]) -> None:
    """Add whole numbers: the least, the default and what it is, by how each is written."""
    for written, (least, default, what) in counts.items():
        described = {written: f"{what} (default {default})"}
        add_options(parser, described, type=at_least(least), default=default)


def run(args: argparse.Namespace) -> int:
    """Run the action; return its exit status."""
    from coded_aperture_ros.core.processes import map_in_processes
    from coded_aperture_ros.design.trials import masks_in_order, measure

    trials = _trials(args)
    check_results_folder(args)
    start = time.perf_counter()
    measured = map_in_processes(measure, trials, args.jobs, "trial")
    seconds = round(time.perf_counter() - start, 1)
    rows = masks_in_order(measured)
    cameras = {trial.camera.mask.name: trial.camera for trial in trials}
    results = _results(args, rows, trials[0].camera, seconds)
    return write_results(args, results, _text, lambda folder: _draw(args, rows, cameras, folder))


def _trials(args: argparse.Namespace) -> list[Any]:
    from coded_aperture_ros.design.trials import Light, trials_of
    from coded_aperture_ros.optics import load_camera, load_mask

    camera = load_camera(args.camera)
    if camera.side == "both":
        raise InputError(
            f"{args.camera}: side: both is not designed for: choose the side of the focal plane"
        )
    near_m, far_m = args.depth_range
    blur_px = camera.blur_range_px(near_m, far_m)
    for name in ("illuminance_lux", "exposure_ms", "full_well", "read_noise", "cut_mm"):
        least = 0 if name in ("read_noise", "cut_mm") else 1e-9
        if not getattr(args, name) >= least:
            args.usage_error(
                f"{written_name(name)}: expected {'0 or ' if not least else ''}more than 0"
            )
    light = Light(args.illuminance_lux, args.exposure_ms, args.full_well, args.read_noise)
    masks = [load_mask(name) for name in dict.fromkeys(args.masks)]
    if args.rounds:
        masks += _searched(args, sorted(abs(size) for size in blur_px))
    scenes = args.scenes, args.unseen
    return trials_of(camera, masks, (near_m, far_m), args.levels, light, scenes, args.cut_mm)


def _searched(args: argparse.Namespace, blur_px: Sequence[float]) -> list[Any]:
    from coded_aperture_ros.design.search.search import SearchConfig
    from coded_aperture_ros.design.trials import searched_masks

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
    args: argparse.Namespace, rows: list[dict[str, Any]], camera: Any, seconds: float
) -> dict[str, Any]:
    from coded_aperture_ros.design.setting import resolutions_m

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
    from coded_aperture_ros.design.trials import PARTS

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
    from coded_aperture_ros.design.trials import CHOOSE, UNSEEN

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
    args: argparse.Namespace, rows: list[dict[str, Any]], cameras: dict[str, Any], folder: Path
) -> None:
    """Draw all masks by light and error, and write pictures and cut files of those not beaten."""
    from coded_aperture_ros.core.files import atomic_output
    from coded_aperture_ros.design.mask_figures import draw_masks_by_light
    from coded_aperture_ros.design.sheet import mask_sheet
    from coded_aperture_ros.design.sheet_files import sheet_svg
    from coded_aperture_ros.design.trials import CHOOSE, UNSEEN
    from coded_aperture_ros.io import write_image

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
