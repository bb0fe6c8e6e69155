"""`coded_aperture calibrate planes`: a bank, focus and blur slope from planes of known depth."""

import dataclasses
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from coded_aperture_ros.calibration.planes.calibrate import PlanesCalibration, calibrate_planes
from coded_aperture_ros.calibration.planes.field import fit_field
from coded_aperture_ros.calibration.planes.folder import add_plane, listed_depths_m, load_planes
from coded_aperture_ros.calibration.planes.pictures import Planes
from coded_aperture_ros.calibration.psf.optics_limits import with_optics_limits
from coded_aperture_ros.cli.calibrate_field import field_summary, field_text, misplaced_planes
from coded_aperture_ros.cli.command import Command, UsageError, argument, group
from coded_aperture_ros.cli.plane_pictures import (
    MASK_FILE,
    PlanesArguments,
    check_size,
    write_report,
)
from coded_aperture_ros.cli.results import Summary, input_files, print_summary
from coded_aperture_ros.cli.rules import excludes, only_with, required
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_outputs, check_output, check_suffix
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.core.text import rounded
from coded_aperture_ros.core.text_table import table
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank_for_camera, save_bank
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.optics.camera_file import camera_entries
from coded_aperture_ros.optics.pupil import measured_beyond_pupil

_EXAMPLES = """examples:
  a folder of pictures with planes.json or planes.csv (file, depth_m):
    coded_aperture calibrate planes planes -o bank.npz
  pictures and their depths in m:
    coded_aperture calibrate planes a.png b.png c.png d.png --depths 0.8,1.0,1.4,2.4 -o bank.npz
  with the camera file, for a bank of another depth range, and a camera file with what was found:
    coded_aperture calibrate planes planes --camera camera.yaml --depth-range 0.9 3 \\
        --output calibration -o bank.npz
  from a running camera, plane by plane (the distance is asked for; an empty line ends):
    coded_aperture calibrate planes planes --topic image_raw -o bank.npz
  one distance for each call, and the learning in the end:
    coded_aperture calibrate planes planes --topic image_raw --depth 1.20

Take 10 to 16 planes parallel to the sensor, all on one side of the focus, equally spaced in inverse
depth, with fine texture all over. A blur of more than 24 px needs a --window-px of twice its width.
--json prints planes, focus_distance_m, slope_px_m, mask, residual_px, left_out_error and more.
"""
_REPORT = "calibrate_planes.json"
_CAMERA = "camera.yaml"
# A lens whose blur changes by less towards the corners is not the reason.
_CURVED_PX = 0.5
_LEVEL_COUNT = 40


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(PlanesArguments):
    """Arguments of `calibrate planes`."""

    depth_range: tuple[float, float] | None = argument(
        "of the bank, in m (default: nearest to farthest plane)",
        None,
        written="--depth-range NEAR FAR",
    )
    level_count: int = argument(
        "levels of the bank", _LEVEL_COUNT, written="--level-count N", minimum=2
    )
    camera: str | None = argument(
        "camera file: its mask is taken for granted, its focus is compared",
        None,
        written="--camera YAML",
    )
    topic: str | None = argument(
        "take pictures from this ROS topic first", None, written="--topic NAME"
    )
    depth: float | None = argument(
        "with --topic: distance of the plane", None, written="--depth Z", unit="m", above=0
    )
    frames: int = argument(
        "with --topic: a picture is the mean of so many frames", 8, written="--frames N", minimum=1
    )
    timeout: float = argument(
        "with --topic: longest wait for the frames", 10.0, written="--timeout S", unit="s", above=0
    )
    bank: str | None = argument("bank (.npz)", None, written="-o FILE", is_output=True)
    output: Path | None = argument(
        f"folder for {_REPORT} and, with --camera, {_CAMERA}", None, written="--output DIR"
    )
    json: bool = argument("print the numbers as JSON", False)
    filters: LearnConfig = group("filters", LearnConfig())


_RULES = (
    required("-o", "--topic", note="where the bank goes"),
    only_with("--depth", "--topic", note="the depths of pictures are given by --depths"),
    excludes("--topic", "--depths"),
)


def run(args: Arguments) -> int:
    """Run the action; return its exit status."""
    if args.topic is not None:
        if len(args.inputs) != 1:
            raise UsageError("--topic: needs one folder")
        if args.depth is None and not sys.stdin.isatty():
            raise UsageError("--topic: without a terminal needs --depth too")
        _capture(args, args.topic)
    return 0 if args.bank is None else _calibrate(args, args.bank)


def _capture(args: Arguments, topic: str) -> None:
    """Take pictures of planes into the folder, one or as many as the user asks for."""
    folder = Path(args.inputs[0])
    check_output(folder / "planes.json")
    there = listed_depths_m(folder)
    if there:
        _say(f"{folder}: has planes at {', '.join(f'{depth:g}' for depth in there)} m")

    # rclpy is only on machines that have ROS.
    from coded_aperture_ros.ros.plane_capture import FrameGrabber

    with FrameGrabber(topic, args.gamma) as grabber:

        def take(depth_m: float) -> None:
            image = grabber.mean_frame(args.frames, args.timeout)
            picture = add_plane(folder, image, depth_m, args.frames)
            _say(f"{picture}: mean of {args.frames} frames, {_light(image)}")

        if args.depth is not None:
            take(args.depth)
            return
        while (depth_m := _asked_depth()) is not None:
            try:
                take(depth_m)
            except InputError as error:
                _say(str(error))


def _light(image: FloatArray) -> str:
    saturated = float(np.mean(image >= 0.995))
    return f"99 % of the pixels below {np.quantile(image, 0.99):.2f}, {saturated:.1%} saturated"


def _asked_depth() -> float | None:
    """Ask for the next distance; None at an empty line or the end of the input."""
    while True:
        print("distance of the plane in m (empty: done): ", end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline().strip()
        if not line:
            return None
        try:
            depth_m = float(line)
        except ValueError:
            depth_m = math.nan
        if 0 < depth_m < math.inf:
            return depth_m
        _say(f"{line}: not a distance, type one such as 1.2")


def _say(text: str) -> None:
    # Not on stdout, where --json has its numbers.
    print(text, file=sys.stderr, flush=True)


def _calibrate(args: Arguments, bank_file: str) -> int:
    check_suffix(bank_file, [".npz"])
    camera = None if args.camera is None else load_camera(args.camera)
    start = time.perf_counter()
    planes = load_planes(args.inputs, args.depths, args.gamma)
    names = (_REPORT, MASK_FILE, _CAMERA) if args.output is not None else ()
    beside = [Path(args.output or "", name) for name in names]
    inputs = [*map(Path, planes.names), *input_files(camera=args.camera)]
    check_output([Path(bank_file), *beside], inputs)
    if camera is not None:
        check_size(str(args.camera), camera, planes)
    try:
        found = calibrate_planes(
            planes,
            args.level_count,
            args.filters,
            args.depth_range,
            None if camera is None else camera.mask,
            progress,
        )
    except InputError as error:
        if camera is None:
            raise
        return _calibrate_field(args, bank_file, camera, planes, error)
    summary = _summary(args, found, camera, round(time.perf_counter() - start, 3))
    _write_files(args, bank_file, found, camera, summary)
    warnings = summary.get("warnings", [])
    return print_summary(summary, _text, as_json=args.json, warnings=warnings)


def _calibrate_field(
    args: Arguments, bank_file: str, camera: Camera, planes: Planes, refused: InputError
) -> int:
    """Learn the bank from the camera file and the field curvature of its lens, if that explains it.

    Else the error that planes are refused with is raised.
    """
    try:
        found = fit_field(camera, planes, progress)
    except InputError:
        raise refused from None
    if found.misplaced:
        raise InputError("; ".join(misplaced_planes(found)))
    summary = {"bank": args.bank, **field_summary(found, found.camera)}
    if abs(summary["corner_px"]) < _CURVED_PX:
        raise refused
    near_m, far_m = args.depth_range or planes.depths_m[[0, -1]].tolist()
    bank = learn_bank_for_camera(found.camera, near_m, far_m, args.level_count, args.filters)
    bank = with_optics_limits(bank, progress)
    with atomic_outputs() as output:
        if args.output is not None:
            write_report(output, args.output / _REPORT, summary, camera.mask)
        save_bank(bank, output(bank_file))
    warning = (
        "the lens is focused elsewhere towards the corners: the bank is that of the camera file "
        "with the lines below, which belong into it; calibrate field --psfs finds more"
    )
    return print_summary(summary, field_text, as_json=args.json, warnings=[warning])


def _summary(
    args: Arguments, found: PlanesCalibration, camera: Camera | None, seconds: float
) -> dict[str, Any]:
    pattern = found.pattern
    bank = found.bank
    left_out = found.left_out
    depths_m = np.asarray(bank.stack.depths_m)
    fitted = pattern.blur_size_px(found.planes.depths_m)
    planes = [
        {
            **dataclasses.asdict(check),
            "blur_size_px": round(float(fitted[i]), 3),
            "measured_px": round(plane.size_px, 3),
            "tilt_px": [round(tilt, 3) for tilt in plane.tilt_px],
            "left_out_depth_m": rounded(left_out.depths_m[i], 5),
            "left_out_error": round(float(left_out.errors[i]), 5),
            "left_out_window_error": round(float(left_out.window_errors[i]), 5),
        }
        for i, (check, plane) in enumerate(zip(found.checks, found.measured, strict=True))
    ]
    summary = {
        "bank": args.bank,
        "output": None if args.output is None else str(args.output),
        "levels": bank.levels,
        "near_m": float(np.min(depths_m)),
        "far_m": float(np.max(depths_m)),
        "mask": pattern.mask.name,
        "mask_is_known": found.mask_is_known,
        "focus_distance_m": rounded(pattern.focus_distance_m, 5),
        "slope_px_m": round(pattern.slope_px_m, 5),
        "side": "far" if np.median(fitted) > 0 else "near",
        "residual_px": round(found.residual_px, 4),
        "left_out_error": round(float(np.median(left_out.errors)), 5),
        "left_out_window_error": round(float(np.median(left_out.window_errors)), 5),
        "planes": planes,
        "advice": [str(advice) for advice in found.advice],
        "seconds": seconds,
    }
    if camera is not None:
        summary["camera"] = args.camera
        summary["camera_focus_distance_m"] = camera.focus_distance_m
        summary["camera_slope_px_m"] = camera.blur_per_dioptre_px
        if math.isfinite(pattern.focus_distance_m):
            camera = camera.refocused(pattern.focus_distance_m)
        extent_mm = round(pattern.slope_px_m / camera.focal_length_px * 1e3, 4)
        summary["mask_extent_mm"] = extent_mm
        beyond = measured_beyond_pupil(pattern.mask, extent_mm, camera.pupil_mm)
        warning = f"{args.camera}: {beyond}; {_CAMERA} is not written"
        summary["warnings"] = [warning] if beyond else []
    return summary


def _write_files(
    args: Arguments,
    bank_file: str,
    found: PlanesCalibration,
    camera: Camera | None,
    summary: Summary,
) -> None:
    """Write the bank and all files of the output folder, or none."""
    bank = with_optics_limits(found.bank, progress)
    with atomic_outputs() as output:
        if args.output is not None:
            write_report(output, args.output / _REPORT, summary, found.pattern.mask)
            finite = math.isfinite(found.pattern.focus_distance_m)
            if camera is not None and finite and not summary["warnings"]:
                text = _camera_text(summary, Path(str(args.camera)))
                output(args.output / _CAMERA).write_text(text, encoding="utf-8")
        save_bank(bank, output(bank_file))


def _camera_text(summary: Summary, path: Path) -> str:
    """Return a camera file with the focus and the mask that were found, for another folder."""
    content = camera_entries(path) | {
        "focus_distance_m": summary["focus_distance_m"],
        "side": summary["side"],
        "mask": {"file": MASK_FILE},
        "mask_extent_mm": summary["mask_extent_mm"],
        "calibrated": "planes",
    }
    return str(yaml.safe_dump(content, sort_keys=False))


def _text(summary: Summary) -> str:
    header = "", "depth m", "bright", "noise", "texture", "blur px", "fit px", "left out m", "error"
    rows = [
        (
            Path(plane["file"]).name[-28:],
            f"{plane['depth_m']:.4g}",
            f"{plane['brightest']:.2f}",
            f"{plane['noise']:.4f}",
            f"{plane['textured']:.0%}",
            f"{plane['measured_px']:.2f}",
            f"{abs(plane['blur_size_px']):.2f}",
            _depth(plane["left_out_depth_m"] or None, "beyond", ""),
            f"{plane['left_out_error']:.1%}",
        )
        for plane in summary["planes"]
    ]
    known = "known" if summary["mask_is_known"] else "found from the pictures, its size is rough"
    lines = [
        f"{len(rows)} planes; blur as measured, and by the lens that fits all",
        table(header, rows),
        f"mask: {summary['mask']} ({known})",
        f"focus at {_depth(summary['focus_distance_m'], 'infinity')}, the planes "
        f"{'beyond' if summary['side'] == 'far' else 'in front of'} it; blur of the mask: "
        f"{summary['slope_px_m']:.4g} px m (1/focus - 1/z), to {summary['residual_px']:.2f} px",
    ]
    if "camera" in summary:
        lines.append(
            f"{summary['camera']}: says focus at {summary['camera_focus_distance_m']:.4g} m and "
            f"{summary['camera_slope_px_m']:.4g} px m; with its focal length the mask is "
            f"{summary['mask_extent_mm']:.4g} mm wide"
        )
    return "\n".join(
        [
            *lines,
            f"expected depth error: {summary['left_out_error']:.1%} of a plane, "
            f"{summary['left_out_window_error']:.1%} of a single window (medians; each plane by "
            "focus and slope of the others, the mask of all)",
            *(f"advice: {text}" for text in summary["advice"]),
            f"{summary['bank']}: {summary['levels']} levels, {summary['near_m']:.4g} to "
            f"{summary['far_m']:.4g} m; {summary['seconds']:.0f} s",
        ]
    )


def _depth(depth_m: float | None, none: str, unit: str = " m") -> str:
    return none if depth_m is None else f"{depth_m:.4g}{unit}"


COMMAND = Command(
    Arguments,
    run,
    description="Check pictures of textured planes at known depths, learn a filter bank from "
    "them, fit the focus distance and the slope of blur over inverse depth, and estimate the "
    "depth error by leaving out one plane after the other. The mask need not be known.",
    examples=_EXAMPLES,
    rules=_RULES,
)
