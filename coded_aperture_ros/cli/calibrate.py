"""`coded_aperture calibrate`: what a lens, a mask and a focus can tell over a depth range.

With an action's name after it, the command measures a camera instead: see `ACTIONS`.
"""

import argparse
import dataclasses
import json
import math
from importlib import import_module
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_output, inputs_of
from coded_aperture_ros.cli.extension import CALIBRATE_REFINE, CALIBRATE_TRACE
from coded_aperture_ros.cli.measuring import checked_config, tell
from coded_aperture_ros.cli.options import add_commands, add_options, settings_of, written_name
from coded_aperture_ros.core.errors import naming

# What is measured from pictures; without an action, the command designs.
ACTIONS: dict[str, Any] = {
    **{
        name: import_module(f"coded_aperture_ros.cli.calibrate_{name}")
        for name in ("blind", "field", "noise", "planes", "psf")
    },
    "refine": CALIBRATE_REFINE,
    "trace": CALIBRATE_TRACE,
}

_EPILOG = """examples:
  the numbers of a camera, and the best focus distance and mask size:
    coded_aperture calibrate --camera config/example_camera.yaml --depth-range 6 28
  with graphs (calibrate.png), a page with sliders (calibrate.html) and all curves (calibrate.json):
    coded_aperture calibrate --camera config/example_camera.yaml --depth-range 6 28 \\
        --output design
  where the lens can be focused from 2 to 5 m only, and the mask be 8 to 14 mm wide:
    coded_aperture calibrate --camera config/example_camera.yaml --depth-range 6 28 \\
        --focus-range 2 5 --mask-range 8 14

--json prints levels, blur_size_near_px, blur_size_far_px (signed: positive beyond the focus),
hole_blur_near_px, hole_blur_far_px, resolution_near_m, resolution_far_m (null: no farther depth
can be told apart), best and more.
"""
_NUMBERS, _PAGE, _PICTURE = "calibrate.json", "calibrate.html", "calibrate.png"


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "calibrate",
        help="show how finely a camera tells depths apart, and the best focus and mask size",
        description="Show how many depths a camera tells apart in a depth range, how finely, and "
        "what the mask costs in light and sharpness; and search for the focus distance and the "
        "mask size that tell most depths apart. Nothing is photographed for it. With an action, "
        "measure a camera from its pictures: 'coded_aperture calibrate ACTION --help'.",
        epilog=_EPILOG,
    )
    camera = "camera file, as config/example_camera.yaml, which explains every entry"
    add_options(parser, {"--camera YAML": camera})
    ranges = {
        "--depth-range NEAR FAR": "where the objects of interest are, in m",
        "--focus-range A B": "focus distances to search and draw, in m (default: NEAR / 4 to 4 "
        "FAR)",
        "--mask-range A B": "mask sizes to search, in mm (default: half to twice the camera "
        "file's)",
    }
    add_options(parser, ranges, type=float)
    results = {
        "-o --output DIR": f"folder for {_NUMBERS}, {_PAGE} and {_PICTURE}",
        "--json": "print the numbers as JSON",
    }
    add_options(parser, results)
    add_commands(parser, "action", ACTIONS.values(), required=False)
    parser.add_late_options = settings_of({"design.DesignConfig": "what is asked of the design"})


def run(args: argparse.Namespace) -> int:
    """Run the sub-command, or one of its actions; return its exit status."""
    if args.action is not None:
        return ACTIONS[args.action].run(args)
    from coded_aperture_ros import design
    from coded_aperture_ros.design.page import finite
    from coded_aperture_ros.optics import load_camera

    # Not required by the parser, which would also ask the actions for them.
    needed = ("camera", "depth_range")
    missing = [written_name(name) for name in needed if getattr(args, name) is None]
    if missing:
        args.usage_error(f"the following arguments are required: {', '.join(missing)}")
    near_m, far_m = args.depth_range
    config = checked_config(args, design.DesignConfig)
    if args.output is not None:
        results = (Path(args.output) / name for name in (_NUMBERS, _PAGE, _PICTURE))
        check_output(results, inputs_of(args, "camera"))
    camera = load_camera(args.camera)
    with naming(args.camera):
        setting = design.design_setting(camera, near_m, far_m, config)
        focus_range_m = args.focus_range or design.default_focus_range_m(camera, near_m, far_m)
        extent_range_mm = args.mask_range or design.default_extent_range_mm(camera)
        best = design.best_settings(camera, near_m, far_m, config, focus_range_m, extent_range_mm)
    openings = design.mask_openings(camera.mask)
    warnings = _warnings(args, setting)
    summary = {
        "camera": args.camera,
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
        "best": dataclasses.asdict(best[0]) if best else None,
        "best_on_other_side": dataclasses.asdict(best[1]) if best[1:] else None,
        "warnings": warnings,
        "output": args.output,
    }
    if args.output is not None:
        with naming(args.camera):
            _write_files(args, camera, config, setting, best, summary)
    return tell(args, finite(summary), lambda _: _table(summary, setting, best), warnings)


def _warnings(args: argparse.Namespace, setting: Any) -> list[str]:
    from coded_aperture_ros.design.figures import has_matplotlib

    warnings = []
    if not setting.diffraction_is_negligible:
        warnings.append(
            f"{args.camera}: the smallest hole, {setting.hole_width_mm:.2f} mm, is below the "
            f"diffraction limit of {setting.diffraction_limit_mm:.2f} mm: the radius of its Airy "
            f"disc is {setting.airy_radius_px:.1f} px; a larger mask has larger holes"
        )
    if args.output is not None and not has_matplotlib():
        warnings.append(
            f"{args.output}: no {_PICTURE}, which needs matplotlib (pip install matplotlib); "
            f"{_PAGE} has the same graphs"
        )
    return warnings


def _write_files(
    args: argparse.Namespace, camera: Any, config: Any, setting: Any, best: Any, summary: Any
) -> None:
    """Write all files of the output folder, or none."""
    from coded_aperture_ros.core.files import atomic_outputs
    from coded_aperture_ros.design import design_curves
    from coded_aperture_ros.design.figures import draw_design, has_matplotlib
    from coded_aperture_ros.design.page import finite, write_page

    near_m, far_m = args.depth_range
    ranges = summary["focus_range_m"], summary["mask_range_mm"]
    curves = design_curves(camera, near_m, far_m, config, args.focus_range)
    lists = {name: values.tolist() for name, values in vars(curves).items()}
    folder = Path(args.output)
    with atomic_outputs() as output:
        numbers = json.dumps(finite({**summary, "curves": lists}), allow_nan=False)
        output(folder / _NUMBERS).write_text(numbers + "\n", encoding="utf-8")
        write_page(camera, near_m, far_m, best, config, *ranges, output(folder / _PAGE))
        if has_matplotlib():
            draw_design(setting, curves, near_m, far_m, output(folder / _PICTURE))


def _table(summary: Any, setting: Any, best: Any) -> str:
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
        _one(
            "smallest hole",
            f"{setting.hole_width_mm:.2f} mm, Airy disc {setting.airy_radius_px:.2f} px "
            f"(1 px at {setting.diffraction_limit_mm:.2f} mm)",
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


def _one(name: str, value: str) -> str:
    return f"  {name:34}  {value}"


def _number(value: float) -> str:
    return "none" if math.isinf(value) else f"{value:.2f}"


def _light(setting: Any) -> str:
    share = f"{100 * setting.open_fraction:.0f} % of the mask's square open"
    if setting.f_number is None:
        return share
    across, light = setting.f_number, setting.f_number_of_light
    return f"{share}; f/{across:.1f} across, as much light as f/{light:.1f}"


def _size(setting: Any) -> str:
    sizes = sorted((abs(setting.blur_size_near_px), abs(setting.blur_size_far_px)))
    return f"{sizes[0]:.1f} to {sizes[1]:.1f}"
