"""`coded_aperture calibrate trace`: the PSFs of a lens from its prescription."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import yaml

from coded_aperture_ros.calibration.prescription.fit import traced_camera
from coded_aperture_ros.calibration.prescription.lens import load_lens
from coded_aperture_ros.cli.command import Command, argument
from coded_aperture_ros.cli.results import Summary, print_summary
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import atomic_output, check_output
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.optics.camera_file import camera_entries

_EXAMPLES = """examples:
  what a double Gauss makes of a mask 15 mm wide in its stop:
    coded_aperture calibrate trace dgauss.zmx --camera camera.yaml --depth-range 1 4 -o traced.yaml

The camera file has focal_length_mm, pixel_pitch_um and, as mask_extent_mm, how wide the mask is in
the stop. A lens that is not a .zmx file is a table with a line for each surface, from the front to
the last one before the sensor: radius, thickness to the next, index and Abbe number of what is
behind it (1 and 0: air), diameter, in mm; 0 is flat, and 'stop' ends the line of the stop.
"""
_REPLACED = (
    "focal_length_mm",
    "pixel_pitch_um",
    "lens_f_number",
    "lens_mask_distance_mm",
    "camera_info",
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments:
    """Arguments of `calibrate trace`."""

    lens: Path = argument(".zmx file, or a table", written="LENS")
    camera: Path = argument("camera file: mask, sensor and focus", written="--camera YAML")
    depth_range: tuple[float, float] = argument(
        "where the blur has to be right, in m", written="--depth-range NEAR FAR"
    )
    output: Path = argument("camera file to write", written="-o --output YAML", is_output=True)
    json: bool = argument("print the numbers as JSON", False)


def run(args: Arguments) -> int:
    """Run the action; return its exit status."""
    check_output(args.output, [args.lens, args.camera], suffixes=[".yaml"])
    near_m, far_m = args.depth_range
    if not 0 < near_m < far_m < math.inf:
        raise InputError(f"--depth-range: expected two increasing depths, got {near_m} {far_m}")
    camera = load_camera(args.camera)
    entries = camera_entries(args.camera)
    if "pixel_pitch_um" not in entries or "wavefront" in entries:
        raise InputError(
            f"camera file {args.camera}: expected focal_length_mm, pixel_pitch_um and no wavefront"
        )
    lens = load_lens(args.lens, camera.wavelength_nm)
    pitch_um = float(entries["pixel_pitch_um"])
    found, left_px = traced_camera(camera, lens, camera.mask_extent_mm, pitch_um, near_m, far_m)
    assert found.wavefront is not None and found.field_curvature is not None
    curvature = found.field_curvature
    changed = {
        "focal_length_px": round(found.focal_length_px, 3),
        "focus_distance_m": round(found.focus_distance_m, 5),
        "mask_extent_mm": round(found.mask_extent_mm, 4),
        "field_curvature": [curvature.second, curvature.fourth],
        "wavefront": found.wavefront.entry,
        "calibrated": "traced",
    }
    kept = {name: value for name, value in entries.items() if name not in _REPLACED}
    with atomic_output(args.output) as temporary:
        temporary.write_text(yaml.safe_dump(kept | changed, sort_keys=False), encoding="utf-8")
    at_corner = np.array([0.0, found.wavefront.corner])
    summary = {
        "focal_length_mm": round(lens.focal_length_mm, 3),
        "entrance_pupil_mm": round(lens.pupil_mm, 3),
        **changed,
        "corner_px": round(
            float(curvature.defocus(at_corner @ at_corner)) * found.blur_per_dioptre_px, 2
        ),
        "corner_light": round(found.wavefront.transmitted_share(found.mask, at_corner), 3),
        "left_px": round(left_px, 3),
        "output": str(args.output),
    }
    return print_summary(summary, _text, as_json=args.json)


def _text(summary: Summary) -> str:
    return (
        "focal length {focal_length_mm:g} mm; the entrance pupil, from which distances count, is "
        "{entrance_pupil_mm:g} mm behind the first surface;\nthe mask's extent in it is "
        "{mask_extent_mm:g} mm, and rays near the axis meet at {focus_distance_m:g} m\nin the "
        "corner the blur is {corner_px:g} px less, and {corner_light:.0%} of the light gets "
        "through; rays land within {left_px:g} px (RMS) of\nwhat {output} says".format(**summary)
    )


COMMAND = Command(
    Arguments,
    run,
    description="Trace rays through the prescription of a lens, and write a camera file with "
    "the focal length, the mask's extent in the entrance pupil, and the PSFs all over the "
    "image that the lens will give its mask: to learn a bank, to simulate, or to choose a "
    "lens before it is bought. Distances are from the entrance pupil.",
    examples=_EXAMPLES,
)
