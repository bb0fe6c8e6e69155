"""`coded_aperture calibrate refine`: what has changed in a camera, from ordinary frames."""

import dataclasses
from contextlib import closing
from itertools import islice
from pathlib import Path

import numpy as np
import yaml

from coded_aperture_ros.calibration.service.refine import Refined, refine_camera
from coded_aperture_ros.cli.command import Command, argument
from coded_aperture_ros.cli.frames import decode
from coded_aperture_ros.cli.reading import PixelArguments
from coded_aperture_ros.cli.results import Summary, print_summary
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError, naming
from coded_aperture_ros.core.files import atomic_outputs, check_output, check_suffix
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.frames import grey_image
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.optics.camera_file import camera_entries, camera_files
from coded_aperture_ros.sources import captures, open_files

_EXAMPLES = """example:
    coded_aperture calibrate refine bag:drive --camera camera.yaml -o refined.yaml

Then: learn the bank again, with the camera file that it wrote; or turn the mask back, or clean it.
A drive of some metres towards furniture tells the focus; anything with texture tells the mask.
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(PixelArguments):
    """Arguments of `calibrate refine`."""

    frames: str = argument(
        "video, bag (bag:PATH#TOPIC) or folder of pictures, in order", written="FRAMES"
    )
    camera: str = argument("camera file as it was set up", written="--camera YAML")
    most_frames: int = argument(
        "stop after so many", 400, written="--most-frames N", minimum=2, daily=False
    )
    output: Path | None = argument(
        "camera file to write, with the mask beside it where it has changed",
        None,
        written="-o --output YAML",
        is_output=True,
    )
    json: bool = argument("print the numbers as JSON", False)


def run(args: Arguments) -> int:
    """Run the action; return its exit status."""
    camera = load_camera(args.camera)
    mask_file = (args.output or Path("refined.yaml")).with_suffix(".mask.npy")
    if args.output is not None:
        check_suffix(args.output, [".yaml"])
        check_output([args.output, mask_file], camera_files(args.camera))
    frames: list[FloatArray] = []
    with closing(open_files(args.frames)) as source, naming(args.frames):
        for capture in progress(islice(captures(source), args.most_frames), None, "frame"):
            frame = decode(capture, args, camera)
            if frame.view is not None:
                raise InputError("the frames show a region of the view, or are binned: record all")
            grey, _ = grey_image(frame.light, 1.0)
            camera = camera.resized(grey.shape[1], grey.shape[0])
            frames.append(grey)
        if len(frames) < 2:
            raise InputError("expected the frames of a video")
        found = refine_camera(camera, frames, progress)
    mask = found.mask
    focus = found.focus
    summary = {
        "frames": len(frames),
        "turned_deg": round(mask.turned_deg, 2),
        "turned_std_deg": round(mask.std_deg, 2),
        "covered": [
            {"row": int(row), "column": int(column)}
            for row, column in zip(*mask.covered.nonzero(), strict=True)
        ],
        "focus_distance_m": round(found.camera.focus_distance_m, 4),
        "dioptres": focus and round(focus.dioptres, 4),
        "dioptres_std": focus and round(focus.std, 4),
        "told": not found.unknown,  # the focus
        "changed": _changes(args.camera, camera, found),
    }
    warnings = [f"focus: {found.unknown}"] if found.unknown else []
    if args.output is not None:
        _write(
            args, args.output, found.camera, mask_file if found.camera.mask != camera.mask else None
        )
    return print_summary(summary, _text, as_json=args.json, warnings=warnings)


def _changes(name: str, camera: Camera, found: Refined) -> list[str]:
    """Say what is not as the camera file says."""
    mask = found.mask
    focus = found.focus
    changes = []
    if found.is_turned:
        way = "clockwise" if mask.turned_deg > 0 else "anticlockwise"
        changes.append(f"the mask is turned {way} by {abs(mask.turned_deg):.1f} degrees")
    for row, column in zip(*mask.covered.nonzero(), strict=True):
        changes.append(f"row {row + 1}, column {column + 1} of the mask is covered")
    if focus is not None and not found.unknown and abs(focus.dioptres) > 3 * focus.std:
        by = (found.camera.focus_distance_m / camera.focus_distance_m - 1) * 100
        changes.append(
            f"the lens is focused at {found.camera.focus_distance_m:.3f} m, "
            f"{by:+.1f} %: depth by {name} is off by {abs(focus.dioptres * focus.depth_m):.0%} at "
            f"{focus.depth_m:.2g} m"
        )
    return changes


def _write(args: Arguments, output: Path, camera: Camera, mask_file: Path | None) -> None:
    """Write the camera file as it was, but for what has changed."""
    entries = camera_entries(args.camera)
    with atomic_outputs() as write:
        entries["focus_distance_m"] = round(camera.focus_distance_m, 5)
        if mask_file is not None:
            np.save(write(mask_file), camera.mask.transmission)
            entries["mask"] = {"file": mask_file.name}
        write(output).write_text(yaml.safe_dump(entries, sort_keys=False), encoding="utf-8")


def _text(summary: Summary) -> str:
    as_said = "the mask is as the camera file says" + (", and so is the focus" * summary["told"])
    lines = summary["changed"] or [as_said]
    known = "not known"
    if summary["dioptres"] is not None:
        known = "{dioptres:+.4f} ± {dioptres_std:.4f} dioptres from where it was".format(**summary)
    numbers = "# {frames} frames: mask turned by {turned_deg:.2f} ± {turned_std_deg:.2f} degrees, "
    return "\n".join([*lines, numbers.format(**summary) + f"focus {known}"])


COMMAND = Command(
    Arguments,
    run,
    description="Find out from the frames of a drive, without any target, whether the lens is "
    "still focused where the camera file says, whether the mask has turned, and whether cells "
    "of it are covered. Takes some minutes.",
    examples=_EXAMPLES,
)
