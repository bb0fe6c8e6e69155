"""`coded_aperture design --for`: which camera for a range, a field of view, and some light."""

import dataclasses
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from coded_aperture_ros.cli.results import Summary, input_files, print_summary
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.figures import save_figure
from coded_aperture_ros.core.files import atomic_outputs, check_output
from coded_aperture_ros.core.processes import map_in_processes
from coded_aperture_ros.core.text_table import columns
from coded_aperture_ros.design.binning import binned_entries, with_binnings
from coded_aperture_ros.design.choice import (
    Offer,
    Outcome,
    Trial,
    Wanted,
    load_offer,
    measure,
    ranked,
    reference_files,
    row,
    trials_for,
)
from coded_aperture_ros.design.choice_figures import draw_choice
from coded_aperture_ros.design.relief import LEAST_FILL, MOST_ERROR
from coded_aperture_ros.optics import MASK_NAMES, load_mask
from coded_aperture_ros.optics.camera_file import camera_entries

_NUMBERS = "design.json"
# Largest ratio of a range's ends that cameras were confirmed with on photographs; of 0.4 to 2 m
# they lost the far half there, which the random scenes here do not show.
_CONFIRMED_RATIO = 3.0
# Columns of the table where binnings are tried.
_FRAME = {"frame": "{image_width} x {image_height}", "pixels": "{pixels:.3g} x"}


@dataclasses.dataclass(frozen=True)
class Request:
    """Arguments of `design --for`."""

    wanted: Wanted
    cameras: tuple[str, ...]  # beside the reference cameras
    masks: tuple[str, ...]  # instead of the camera files'
    binnings: tuple[int, ...]  # beside the camera files'
    only: bool  # no reference cameras
    plot: str | None
    output: Path | None
    jobs: int
    as_json: bool


def run_for(request: Request) -> int:
    """Print the table; return the exit status."""
    reference = [] if request.only else reference_files()
    paths = list(dict.fromkeys([*map(Path, request.cameras), *reference]))
    if not paths:
        raise InputError("no camera to choose from: name camera files, or leave out --no-reference")
    offers, warnings = _offers(request, paths)
    _check_outputs(request, offers)
    start = time.perf_counter()
    trials, refused = _trials(request, offers)
    warnings += [*refused, *wide_range(request.wanted)]
    outcomes = ranked(map_in_processes(measure, trials, request.jobs, "camera"))
    rows = [row(one) for one in outcomes]
    summary = {
        **dataclasses.asdict(request.wanted),
        "binnings": list(request.binnings),
        "most_error": MOST_ERROR,
        "least_fill": LEAST_FILL,
        "cameras": rows,
        "warnings": warnings,
        "seconds": round(time.perf_counter() - start, 1),
    }
    with atomic_outputs() as output:
        if request.plot is not None:
            save_figure(draw_choice(rows, request.wanted), output(Path(request.plot)))
        if request.output is not None:
            numbers = json.dumps(summary, allow_nan=False)
            output(request.output / _NUMBERS).write_text(numbers + "\n", encoding="utf-8")
            for one in outcomes:
                path = output(request.output / one.trial.offer.file_name)
                path.write_text(_camera_text(one, request.masks), encoding="utf-8")
    return print_summary(summary, _text, as_json=request.as_json, warnings=warnings)


def wide_range(wanted: Wanted) -> list[str]:
    """What to know of a range that is wider than those confirmed; empty for others."""
    ratio = wanted.far_m / wanted.near_m
    if ratio <= _CONFIRMED_RATIO:
        return []
    return [
        f"1 : {ratio:.2g} is a wide range: on photographs, unlike on the random scenes here, "
        "cameras lose its far half; ask for 1 : 3, or confirm it (docs/data_sheets.md)"
    ]


def _offers(request: Request, paths: Sequence[Path]) -> tuple[list[Offer], list[str]]:
    """Offers of all camera files with all binnings, and why some have none."""
    found: list[Offer] = []
    refused: list[str] = []
    for path in paths:
        offers, reasons = with_binnings(load_offer(path), request.binnings)
        found += offers
        refused += reasons
    return found, refused


def _check_outputs(request: Request, offers: Sequence[Offer]) -> None:
    inputs = [file for one in offers for file in input_files(camera=str(one.path))]
    if request.plot is not None:
        check_output(request.plot, inputs, (".png",))
    if request.output is not None:
        names = [_NUMBERS, *(one.file_name for one in offers)]
        doubled = {name for name in names if names.count(name) > 1}
        if doubled:
            raise InputError(f"{min(doubled)}: two camera files have this name: rename one")
        check_output([request.output / name for name in names], inputs)


def _trials(request: Request, offers: Sequence[Offer]) -> tuple[list[Trial], list[str]]:
    """Trials of all cameras, and why some have none."""
    masks = [load_mask(name) for name in request.masks]
    found: list[Trial] = []
    refused: list[str] = []
    for offer in offers:
        try:
            found += trials_for(offer, request.wanted, masks)
        except InputError as error:
            refused.append(f"{error}; left out")
    if not found:
        raise InputError("; ".join(refused))
    return found, refused


def _camera_text(outcome: Outcome, masks: Sequence[str]) -> str:
    """Camera file with the mask, of some names and files or its own, the focus, the binning."""
    camera = outcome.trial.camera
    offer = outcome.trial.offer
    entries = camera_entries(offer.path)
    if offer.binning is not None:
        entries = binned_entries(entries, offer.binning)
    for name in masks:
        if load_mask(name) == camera.mask:
            known = name in MASK_NAMES
            entries["mask"] = {"name": name} if known else {"file": str(Path(name).resolve())}
    entries |= {
        "mask_extent_mm": int(1e3 * camera.mask_extent_mm) / 1e3,
        "focus_distance_m": round(camera.focus_distance_m, 4),
        "side": "far",
        "diffraction": True,
    }
    entries.pop("reference", None)
    return str(yaml.safe_dump(entries, sort_keys=False))


def _text(summary: Summary) -> str:
    wanted = f"{summary['near_m']:g} to {summary['far_m']:g} m"
    if summary["view_deg"]:
        wanted += f", {summary['view_deg']:g} degrees across"
    lines = [
        f"{wanted}, {summary['illuminance_lux']:g} lux at {summary['rate_hz']:g} Hz; range: median "
        f"error of at most {100 * MOST_ERROR:g} % and {100 * LEAST_FILL:g} % of the pixels filled, "
        "on simulated scenes with texture",
        columns(
            summary["cameras"],
            {
                "camera": "{camera}",
                **(_FRAME if summary["binnings"] else {}),
                "range": _range,
                "error": lambda row: _per_cent(row["error"], 1),
                "fill": lambda row: _per_cent(row["fill"], 0),
                "view": lambda row: "{:.0f} x {:.0f}".format(*row["view_deg"]),
                "mask": lambda row: f"{row['mask']} {row['mask_extent_mm']:.3g} mm",
                "focus": "{focus_distance_m:.3g} m",
                "light lost": _stops,
                "exposure": lambda row: f"{row['exposure_ms']:.2g} ms",
                "price": lambda row: row["price_class"] or "-",
            },
        ),
        *(f"{one['camera']}: {one['limits']}" for one in summary["cameras"] if one["limits"]),
    ]
    return "\n".join(lines)


def _range(row: dict[str, Any]) -> str:
    if row["range_m"] is None:
        return "none"
    near_m, far_m = row["range_m"]
    return f"{near_m:.2f} to {far_m:.2f} m"


def _per_cent(share: float | None, digits: int) -> str:
    return "-" if share is None else f"{100 * share:.{digits}f} %"


def _stops(row: dict[str, Any]) -> str:
    lost = row["light_lost_stops"]
    return "-" if lost is None else f"{lost:.1f} stops"
