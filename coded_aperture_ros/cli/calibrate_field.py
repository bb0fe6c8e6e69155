"""`coded_aperture calibrate field`: how the focus of a lens moves away from the image's middle."""

import argparse
from typing import Any

from coded_aperture_ros.cli.calibrate_planes import check_size
from coded_aperture_ros.cli.measuring import add_planes_arguments, tell
from coded_aperture_ros.cli.options import add_gamma_option, add_options
from coded_aperture_ros.cli.progress import progress

_EPILOG = """example:
    coded_aperture calibrate field planes --camera camera.yaml

Then: put mask_extent_mm and field_curvature into the camera file, and learn the bank again. Take 6
or more planes parallel to the sensor, with fine texture up to the corners, over the range of depth
that matters; distances are from the entrance pupil of the lens.
"""
_FIGURES = ("depth_m", "found_m", "error_without", "error")


def add_parser(subparsers: Any) -> None:
    """Add the action to the sub-command's parser."""
    parser = subparsers.add_parser(
        "field",
        help="measure the field curvature of a lens from pictures of planes at known depths",
        description="Measure how the blur falls or grows towards the corners of the image, which "
        "would pass for another depth, from pictures of textured planes at known depths.",
        epilog=_EPILOG,
    )
    add_planes_arguments(parser)
    add_options(parser, {"--camera YAML": "camera file, with mask and focus"}, required=True)
    add_gamma_option(parser)
    add_options(parser, {"--json": "print the numbers as JSON"})


def run(args: argparse.Namespace) -> int:
    """Run the action; return its exit status."""
    import numpy as np

    from coded_aperture_ros.calibration.planes.field import fit_field
    from coded_aperture_ros.calibration.planes.folder import load_planes
    from coded_aperture_ros.optics import load_camera

    planes = load_planes(args.inputs, args.depths, args.gamma)
    camera = load_camera(args.camera)
    check_size(args.camera, camera, planes)
    found = fit_field(camera, planes, progress)
    columns = found.depths_m, found.found_m, found.errors_without, found.errors
    corner = float(found.curvature.dioptres(camera.intrinsics, planes.images[0].shape)[0, 0])
    summary = {
        "mask_extent_mm": found.mask_extent_mm,
        "field_curvature": [found.curvature.second, found.curvature.fourth],
        "corner_dioptres": round(corner, 4),
        "corner_px": round(corner * found.mask_extent_mm * 1e-3 * camera.focal_length_px, 2),
        "planes": [
            {"name": name, **dict(zip(_FIGURES, np.round(row, 4).tolist(), strict=True))}
            for name, *row in zip(found.names, *columns, strict=True)
        ],
    }
    warnings = [
        f"{found.names[index]}: at {found.depths_m[index]:g} m, but blurred as at "
        f"{found.found_m[index]:.3g} m by the other planes: check the distance"
        for index in found.misplaced
    ]
    return tell(args, summary, _text, warnings)


def _text(summary: dict[str, Any]) -> str:
    planes = summary["planes"]
    lines = [
        f"mask_extent_mm: {summary['mask_extent_mm']:g}",
        f"field_curvature: {summary['field_curvature']}  # dioptres",
        f"# in the corner the blur is {summary['corner_px']:g} px less, by "
        f"{summary['corner_dioptres']:g} dioptres; median errors of the planes:",
        "#    at, m   without   with the fit to the others",
    ]
    row = "# {depth_m:8.4g}{error_without:10.1%}{error:10.1%}".format
    return "\n".join([*lines, *(row(**plane) for plane in planes)])
