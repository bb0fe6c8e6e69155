"""`coded_aperture calibrate field`: how the focus of a lens moves away from the image's middle."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from coded_aperture_ros.calibration.planes.field import FieldFit, fit_field
from coded_aperture_ros.calibration.planes.folder import load_planes
from coded_aperture_ros.calibration.planes.wavefront import fit_wavefront
from coded_aperture_ros.cli.command import Command, argument
from coded_aperture_ros.cli.field_report import field_page
from coded_aperture_ros.cli.plane_pictures import PlanesArguments, check_size
from coded_aperture_ros.cli.results import Summary, input_files, print_summary
from coded_aperture_ros.cli.rules import needs
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.files import atomic_output, check_output, check_suffix
from coded_aperture_ros.core.progress import progress
from coded_aperture_ros.io import write_image
from coded_aperture_ros.likelihood.bank.field import COLUMNS, FieldPsfs
from coded_aperture_ros.optics import Camera, load_camera
from coded_aperture_ros.optics.camera_file import camera_entries

_EXAMPLES = """examples:
    coded_aperture calibrate field planes --camera camera.yaml -o fitted.yaml
    coded_aperture calibrate field planes --camera camera.yaml --psfs -o fitted.yaml

Then: learn the bank again, with the new camera file. Take 6 or more planes
parallel to the sensor, with fine texture up to the corners, over the range of depth that matters;
distances are from the entrance pupil of the lens.
"""
# What a camera file gets of it.
_FOUND = ("mask_extent_mm", "field_curvature", "wavefront", "calibrated")
_FIGURES = ("depth_m", "found_m", "error_without", "error")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments(PlanesArguments):
    """Arguments of `calibrate field`."""

    camera: str = argument("camera file, with mask and focus", written="--camera YAML")
    psfs: bool = argument(
        "find how the PSF changes over the image, too: astigmatism, coma, spherical aberration, "
        "and what the lens cuts off; takes minutes",
        False,
    )
    picture: str | None = argument(
        "with --psfs: draw the PSFs of the parts of the image",
        None,
        written="--picture PNG",
        is_output=True,
    )
    report: str | None = argument(
        "page with blur, as measured and predicted, and errors by plane and radius, and PSFs",
        None,
        written="--report HTML",
        is_output=True,
    )
    output: Path | None = argument(
        "camera file to write: as it was, with what was found",
        None,
        written="-o --output YAML",
        is_output=True,
    )
    json: bool = argument("print the numbers as JSON", False)


_RULES = (needs("--picture", "--psfs"),)


def run(args: Arguments) -> int:
    """Run the action; return its exit status."""
    planes = load_planes(args.inputs, args.depths, args.gamma)
    outputs = [Path(name) for name in (args.picture, args.report, args.output) if name is not None]
    check_output(outputs, [*map(Path, planes.names), *input_files(camera=args.camera)])
    if args.output is not None:
        check_suffix(args.output, [".yaml"])
    camera = load_camera(args.camera)
    check_size(args.camera, camera, planes)
    found = fit_field(camera, planes, progress)
    bent = found.camera
    if args.psfs:
        bent = fit_wavefront(bent, planes, found.trusted, progress)
    sizes_px = bent.blur_size_px(found.depths_m)
    widest, narrowest = abs(sizes_px).argmax(), abs(sizes_px).argmin()
    if args.picture is not None:
        write_image(args.picture, _picture(bent, sizes_px[[widest]]))
    summary, misplaced = field_summary(found, bent), misplaced_planes(found)
    if args.report is not None:
        pictures = {
            f"at {found.depths_m[plane]:.4g} m": _picture(bent, sizes_px[[plane]])
            for plane in (narrowest, widest)
            if bent.wavefront is not None
        }
        with atomic_output(args.report) as path:
            path.write_text(field_page(found, field_text(summary), pictures, misplaced), "utf-8")
    if args.output is not None:
        changed = {name: summary[name] for name in _FOUND if name in summary}
        entries = {**camera_entries(args.camera), **changed}
        with atomic_output(args.output) as path:
            path.write_text(yaml.safe_dump(entries, sort_keys=False), encoding="utf-8")
    return print_summary(summary, field_text, as_json=args.json, warnings=misplaced)


def field_summary(found: FieldFit, camera: Camera) -> dict[str, Any]:
    """Return what planes say of a lens, as numbers; `camera` is the one with what was found."""
    curvature = camera.field_curvature or found.curvature
    columns = found.depths_m, found.found_m, found.errors_without, found.errors
    shape = camera.image_height, camera.image_width
    corner = float(curvature.defocus_map(camera.intrinsics, shape)[0, 0])
    return {
        "mask_extent_mm": camera.mask_extent_mm,
        "field_curvature": [curvature.second, curvature.fourth],
        **({"wavefront": camera.wavefront.entry} if camera.wavefront is not None else {}),
        "calibrated": "field",
        "corner_dioptres": round(corner, 4),
        "corner_px": round(corner * camera.blur_per_dioptre_px, 2),
        "planes": [
            {"name": name, **dict(zip(_FIGURES, np.round(row, 4).tolist(), strict=True))}
            for name, *row in zip(found.names, *columns, strict=True)
        ],
    }


def misplaced_planes(found: FieldFit) -> list[str]:
    """Say which planes are not where they were said to be."""
    return [
        f"{found.names[index]}: at {found.depths_m[index]:g} m, but blurred as at "
        f"{found.found_m[index]:.3g} m by the other planes: check the distance"
        for index in found.misplaced
    ]


def _picture(camera: Camera, blur_size_px: DoubleArray) -> FloatArray:
    """Return the PSFs of the parts of the image, side by side as they lie."""
    psfs = FieldPsfs.from_camera(camera, blur_size_px).psfs[:, 0]  # type: ignore[union-attr]
    tiles = np.pad(psfs / psfs.max(), ((0, 0), (1, 1), (1, 1)))
    drawn = np.vstack([np.hstack(row) for row in tiles.reshape(-1, COLUMNS, *tiles.shape[1:])])
    return cv2.resize(drawn, None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST)


def field_text(summary: Summary) -> str:
    """Return the same as lines of a camera file, with remarks."""
    planes = summary["planes"]
    lines = [
        f"mask_extent_mm: {summary['mask_extent_mm']:g}",
        f"field_curvature: {summary['field_curvature']}  # dioptres",
        *([f"wavefront: {json.dumps(summary['wavefront'])}"] if "wavefront" in summary else []),
        f"calibrated: {summary['calibrated']}",
        f"# in the corner the blur is {summary['corner_px']:g} px less, by "
        f"{summary['corner_dioptres']:g} dioptres; median errors of the planes:",
        "#    at, m   without   with the fit to the others",
    ]
    row = "# {depth_m:8.4g}{error_without:10.1%}{error:10.1%}".format
    return "\n".join([*lines, *(row(**plane) for plane in planes)])


COMMAND = Command(
    Arguments,
    run,
    description="Measure how the blur falls or grows towards the corners of the image, which "
    "would pass for another depth, from pictures of textured planes at known depths.",
    examples=_EXAMPLES,
    rules=_RULES,
)
