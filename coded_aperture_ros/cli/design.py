"""`coded_aperture design`: what a lens, a mask and a focus can tell over a depth range."""

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.command import Command, argument, group
from coded_aperture_ros.cli.design_for import Request, run_for
from coded_aperture_ros.cli.results import Summary, input_files, print_summary
from coded_aperture_ros.cli.rules import excludes, only_with, required
from coded_aperture_ros.core.errors import naming
from coded_aperture_ros.core.files import atomic_outputs, check_output
from coded_aperture_ros.core.workers import processors
from coded_aperture_ros.design import (
    DesignConfig,
    best_settings,
    default_extent_range_mm,
    default_focus_range_m,
    design_curves,
    design_setting,
    extents_within_pupil,
    mask_openings,
)
from coded_aperture_ros.design.choice import Wanted
from coded_aperture_ros.design.figures import draw_design, has_matplotlib
from coded_aperture_ros.design.page import finite, write_page
from coded_aperture_ros.design.setting import Setting
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.optics.pupil import exceeds_pupil, largest_extent_mm, wider_mask_advice

_EXAMPLES = """examples:
  which camera for 0.6 to 1.5 m and 30 degrees, in an office, at 20 frames a second (two minutes):
    coded_aperture design --for 0.6 1.5 --view-deg 30 --lux 300 --rate-hz 20 --plot cameras.png
  a camera of yours alone, the better of two masks, and a camera file with what was chosen:
    coded_aperture design --for 6 28 config/example_camera.yaml --no-reference \\
        --masks levin four_hole --output chosen
  the numbers of a camera, and the best focus distance and mask size:
    coded_aperture design --camera config/example_camera.yaml --depth-range 6 28
  with graphs (design.png), a page with sliders (design.html) and all curves (design.json):
    coded_aperture design --camera config/example_camera.yaml --depth-range 6 28 \\
        --output design
  where the lens can be focused from 2 to 5 m only, and the mask be 8 to 14 mm wide:
    coded_aperture design --camera config/example_camera.yaml --depth-range 6 28 \\
        --focus-range 2 5 --mask-range 8 14

--json prints levels, blur_size_near_px, blur_size_far_px (signed: positive beyond the focus),
hole_blur_near_px, hole_blur_far_px, resolution_near_m, resolution_far_m (null: no farther depth
can be told apart), best and more.
"""
_NUMBERS = "design.json"
_PAGE = "design.html"
_PICTURE = "design.png"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments:
    """Arguments of `design`."""

    cameras: tuple[str, ...] = argument(
        "camera files to compare with the reference cameras", (), written="CAMERA"
    )
    wanted: tuple[float, float] | None = argument(
        "rank the reference cameras, and CAMERA, for a depth range in m, by simulated scenes",
        None,
        written="--for NEAR FAR",
    )
    view_deg: float = argument(
        "least horizontal field of view", 0.0, written="--view-deg DEG", minimum=0, maximum=179
    )
    lux: float = argument(
        "light on the scene: a dim room has 50, an office 300, a cloudy day 10,000",
        300.0,
        written="--lux E",
        above=0,
    )
    rate_hz: float = argument("frames a second", 20.0, written="--rate-hz F", above=0)
    masks: tuple[str, ...] = argument(
        "names or files of masks to try in every camera (default: the camera file's)",
        (),
        written="--masks MASK",
    )
    binning: tuple[int, ...] = argument(
        "try each camera whose file describes its sensor with these binnings too: a smaller one "
        "has more pixels and takes longer",
        (),
        written="--binning N",
        minimum=1,
        maximum=64,
    )
    no_reference: bool = argument("rank CAMERA alone", False, written="--no-reference")
    plot: str | None = argument(
        "figure of error and fill over distance (PNG)", None, written="--plot PNG", is_output=True
    )
    jobs: int = argument(
        "processes (default: one for each processor)",
        processors(),
        written="--jobs N",
        minimum=1,
        daily=False,
    )
    camera: str | None = argument(
        "camera file, as config/example_camera.yaml, which explains every entry",
        None,
        written="--camera YAML",
    )
    depth_range: tuple[float, float] | None = argument(
        "where the objects of interest are, in m", None, written="--depth-range NEAR FAR"
    )
    focus_range: tuple[float, float] | None = argument(
        "focus distances to search and draw, in m (default: NEAR / 4 to 4 FAR)",
        None,
        written="--focus-range A B",
    )
    mask_range: tuple[float, float] | None = argument(
        "mask sizes to search, in mm (default: half to twice the camera file's)",
        None,
        written="--mask-range A B",
    )
    output: Path | None = argument(
        f"folder for {_NUMBERS}, {_PAGE} and {_PICTURE}", None, written="-o --output DIR"
    )
    json: bool = argument("print the numbers as JSON", False)
    config: DesignConfig = group("what is asked of the design", DesignConfig())


_RULES = (
    required("--for", "--camera & --depth-range"),
    excludes("--for", "--camera", "--depth-range", "--focus-range", "--mask-range"),
    excludes("config.*", "--for", note="which has limits of its own"),
    only_with("CAMERA", "--for"),
    *(
        only_with(name, "--for")
        for name in (
            "--view-deg",
            "--lux",
            "--rate-hz",
            "--masks",
            "--binning",
            "--no-reference",
            "--plot",
        )
    ),
)


def run(args: Arguments) -> int:
    """Print the numbers; return the exit status."""
    if args.wanted is not None:
        wanted = Wanted(*args.wanted, args.view_deg, args.lux, args.rate_hz)
        return run_for(
            Request(
                wanted,
                args.cameras,
                args.masks,
                args.binning,
                args.no_reference,
                args.plot,
                args.output,
                args.jobs,
                args.json,
            )
        )
    assert args.camera is not None and args.depth_range is not None
    return _run_one(args, args.camera, *args.depth_range)


def _run_one(args: Arguments, camera_file: str, near_m: float, far_m: float) -> int:
    config = args.config
    if args.output is not None:
        results = (args.output / name for name in (_NUMBERS, _PAGE, _PICTURE))
        check_output(results, input_files(camera=camera_file))
    camera = load_camera(camera_file)
    with naming(camera_file):
        setting = design_setting(camera, near_m, far_m, config)
        focus_range_m = args.focus_range or default_focus_range_m(camera, near_m, far_m)
        extent_range_mm = extents_within_pupil(
            camera, args.mask_range or default_extent_range_mm(camera)
        )
        best = best_settings(camera, near_m, far_m, config, focus_range_m, extent_range_mm)
    openings = mask_openings(camera.mask)
    warnings = _warnings(args, camera, setting)
    summary = {
        "camera": camera_file,
        "mask": camera.mask.name,
        "near_m": near_m,
        "far_m": far_m,
        **dataclasses.asdict(setting),
        "ambiguous_focus_m": [near_m, far_m],
        "openings": openings.count,
        "diffraction_is_negligible": setting.diffraction_is_negligible,
        **dataclasses.asdict(config),
        "focus_range_m": list(focus_range_m),
        "mask_range_mm": list(extent_range_mm),
        "pupil_mm": camera.pupil_mm,
        "largest_mask_mm": largest_extent_mm(camera.mask, camera.pupil_mm),
        "best": dataclasses.asdict(best[0]) if best else None,
        "best_on_other_side": dataclasses.asdict(best[1]) if best[1:] else None,
        "warnings": warnings,
        "output": None if args.output is None else str(args.output),
    }
    if args.output is not None:
        with naming(camera_file):
            _write_files(args, args.output, camera, setting, best, summary)
    return print_summary(
        finite(summary),
        lambda _: _table(summary, setting, best),
        as_json=args.json,
        warnings=warnings,
    )


def _warnings(args: Arguments, camera: Camera, setting: Setting) -> list[str]:
    warnings = []
    wider = wider_mask_advice(camera.mask, camera.mask_extent_mm, camera.pupil_mm)
    if not setting.diffraction_is_negligible:
        warnings.append(
            f"{args.camera}: the smallest hole, {setting.hole_width_mm:.2f} mm, is below the "
            f"diffraction limit of {setting.diffraction_limit_mm:.2f} mm: its Airy disc is "
            f"{setting.airy_width_px:.1f} px wide; take {wider}, or one with "
            "larger holes"
        )
    largest_mm = largest_extent_mm(camera.mask, camera.pupil_mm)
    if args.mask_range is not None and args.mask_range[1] > largest_mm:
        reason = exceeds_pupil(camera.mask, args.mask_range[1], camera.pupil_mm)
        warnings.append(f"--mask-range: {reason or f'the pupil takes {largest_mm:g} mm'}")
    if args.output is not None and not has_matplotlib():
        warnings.append(
            f"{args.output}: no {_PICTURE}, which needs matplotlib (pip install matplotlib); "
            f"{_PAGE} has the same graphs"
        )
    return warnings


def _write_files(
    args: Arguments,
    folder: Path,
    camera: Camera,
    setting: Setting,
    best: list[Setting],
    summary: dict[str, Any],
) -> None:
    """Write all files of the output folder, or none."""
    near_m, far_m = summary["near_m"], summary["far_m"]
    ranges = summary["focus_range_m"], summary["mask_range_mm"]
    curves = design_curves(camera, near_m, far_m, args.config, args.focus_range)
    lists = {name: values.tolist() for name, values in vars(curves).items()}
    with atomic_outputs() as output:
        numbers = json.dumps(finite({**summary, "curves": lists}), allow_nan=False)
        output(folder / _NUMBERS).write_text(numbers + "\n", encoding="utf-8")
        write_page(camera, near_m, far_m, best, args.config, *ranges, output(folder / _PAGE))
        if has_matplotlib():
            draw_design(setting, curves, near_m, far_m, output(folder / _PICTURE))


def _table(summary: Summary, setting: Setting, best: Sequence[Setting]) -> str:
    near_m, far_m = summary["near_m"], summary["far_m"]
    pairs = [("", "nearest", "farthest", "")] + [
        (name, *(_number(getattr(setting, f"{of}_{end}_{unit}")) for end in ("near", "far")), unit)
        for name, of, unit in (
            ("blur of the mask", "blur_size", "px"),
            ("blur of the smallest hole", "hole_blur", "px"),
            ("to the next depth told apart", "resolution", "m"),
        )
    ]
    lines = [
        f"{summary['camera']}: mask {summary['mask']}, {setting.mask_extent_mm:g} mm; focus at "
        f"{setting.focus_distance_m:g} m, scene {near_m:g} to {far_m:g} m",
        f"  {'depth levels told apart':34}{setting.levels:9.1f}",
        *(f"  {name:34}{near:>9}{far:>10} {unit}".rstrip() for name, near, far, unit in pairs),
        _one("mean blur of the smallest hole", f"{setting.hole_blur_mean_px:.2f} px"),
        _one("ambiguous focus distances", f"{near_m:g} to {far_m:g} m"),
        _one("light", _light(setting)),
        *_pupil(summary),
        _one(
            "smallest hole",
            f"{setting.hole_width_mm:.2f} mm, Airy disc {setting.airy_width_px:.2f} px wide "
            f"(2 px at {setting.diffraction_limit_mm:.2f} mm)",
        ),
    ]
    lines += [
        f"best with the focus {'before' if one.side == 'far' else 'beyond'} the scene "
        f"(side: {one.side}):\n  focus at {one.focus_distance_m:.3g} m, mask of "
        f"{one.mask_extent_mm:.3g} mm: {one.levels:.1f} levels; blur of {_size(one)} px, of a hole "
        f"{one.hole_blur_mean_px:.2f} px in the mean"
        for one in best
    ]
    if not best:
        low_m, high_m = summary["focus_range_m"]
        narrow_mm, wide_mm = summary["mask_range_mm"]
        lines.append(
            f"best: none, no focus of {low_m:.3g} to {high_m:.3g} m with a mask of {narrow_mm:.3g} "
            f"to {wide_mm:.3g} mm keeps the blur within {summary['smallest_blur_px']:g} to "
            f"{summary['largest_blur_px']:g} px"
        )
    if summary["output"] is not None:
        lines.append(f"{summary['output']}: open {_PAGE} in a browser")
    return "\n".join(lines)


def _pupil(summary: Summary) -> list[str]:
    if summary["pupil_mm"] is None:
        return []
    of_lens = f"{summary['pupil_mm']:.3g} mm wide, takes a mask of up to "
    return [_one("pupil", of_lens + f"{summary['largest_mask_mm']:g} mm")]


def _one(name: str, value: str) -> str:
    return f"  {name:34}  {value}"


def _number(value: float) -> str:
    return "none" if math.isinf(value) else f"{value:.2f}"


def _light(setting: Setting) -> str:
    share = f"{100 * setting.open_fraction:.0f} % of the mask's square open"
    if setting.f_number is None:
        return share
    across, light = setting.f_number, setting.f_number_of_light
    return f"{share}; f/{across:.1f} across, as much light as f/{light:.1f}"


def _size(setting: Setting) -> str:
    sizes = sorted((abs(setting.blur_size_near_px), abs(setting.blur_size_far_px)))
    return f"{sizes[0]:.1f} to {sizes[1]:.1f}"


COMMAND = Command(
    Arguments,
    run,
    description="Rank cameras for a range and some light (--for), by simulated scenes. Or show "
    "how many depths a camera tells apart in a depth range, how finely, and "
    "what the mask costs in light and sharpness; and search for the focus distance and the "
    "mask size that tell most depths apart. Nothing is photographed for it.",
    examples=_EXAMPLES,
    rules=_RULES,
)
