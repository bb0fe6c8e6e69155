"""`coded_aperture calibrate field`: how the focus of a lens moves away from the image's middle."""

import argparse
import json
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_output, inputs_of
from coded_aperture_ros.cli.measuring import add_planes_arguments, check_size, tell
from coded_aperture_ros.cli.options import add_gamma_option, add_options
from coded_aperture_ros.core.progress import progress

_EPILOG = """examples:
    coded_aperture calibrate field planes --camera camera.yaml
    coded_aperture calibrate field planes --camera camera.yaml --psfs --report lens.html

Then: put what it prints into the camera file, and learn the bank again. Take 6 or more planes
parallel to the sensor, with fine texture up to the corners, over the range of depth that matters;
distances are from the entrance pupil of the lens.
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
    add_options(
        parser,
        {
            "--psfs": "find how the PSF changes over the image, too: astigmatism, coma, spherical "
            "aberration, and what the lens cuts off; takes minutes",
            "--picture PNG": "with --psfs: draw the PSFs of the parts of the image",
            "--report HTML": "page with blur, as measured and predicted, and errors by plane and "
            "radius, and PSFs",
            "--json": "print the numbers as JSON",
        },
    )


def run(args: argparse.Namespace) -> int:
    """Run the action; return its exit status."""
    from coded_aperture_ros.calibration.planes.field import fit_field
    from coded_aperture_ros.calibration.planes.folder import load_planes
    from coded_aperture_ros.calibration.planes.wavefront import fit_wavefront
    from coded_aperture_ros.cli.field_report import field_page
    from coded_aperture_ros.core.files import atomic_output
    from coded_aperture_ros.io import write_image
    from coded_aperture_ros.optics import load_camera

    if args.picture is not None and not args.psfs:
        args.usage_error("--picture: draws what --psfs finds, give both")
    planes = load_planes(args.inputs, args.depths, args.gamma)
    outputs = [Path(name) for name in (args.picture, args.report) if name is not None]
    check_output(outputs, [*map(Path, planes.names), *inputs_of(args, "camera")])
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
    return tell(args, summary, field_text, misplaced)


def field_summary(found: Any, camera: Any) -> dict[str, Any]:
    """Return what planes say of a lens, as numbers; `camera` is the one with what was found."""
    import numpy as np

    curvature = camera.field_curvature or found.curvature
    columns = found.depths_m, found.found_m, found.errors_without, found.errors
    shape = camera.image_height, camera.image_width
    corner = float(curvature.defocus_map(camera.intrinsics, shape)[0, 0])
    return {
        "mask_extent_mm": camera.mask_extent_mm,
        "field_curvature": [curvature.second, curvature.fourth],
        **({"wavefront": camera.wavefront.entry} if camera.wavefront is not None else {}),
        "corner_dioptres": round(corner, 4),
        "corner_px": round(corner * camera.blur_per_dioptre_px, 2),
        "planes": [
            {"name": name, **dict(zip(_FIGURES, np.round(row, 4).tolist(), strict=True))}
            for name, *row in zip(found.names, *columns, strict=True)
        ],
    }


def misplaced_planes(found: Any) -> list[str]:
    """Say which planes are not where they were said to be."""
    return [
        f"{found.names[index]}: at {found.depths_m[index]:g} m, but blurred as at "
        f"{found.found_m[index]:.3g} m by the other planes: check the distance"
        for index in found.misplaced
    ]


def _picture(camera: Any, blur_size_px: Any) -> Any:
    """Return the PSFs of the parts of the image, side by side as they lie."""
    import cv2
    import numpy as np

    from coded_aperture_ros.likelihood.bank.field import COLUMNS, FieldPsfs

    psfs = FieldPsfs.of(camera, blur_size_px).psfs[:, 0]  # type: ignore[union-attr]
    tiles = np.pad(psfs / psfs.max(), ((0, 0), (1, 1), (1, 1)))
    drawn = np.vstack([np.hstack(row) for row in tiles.reshape(-1, COLUMNS, *tiles.shape[1:])])
    return cv2.resize(drawn, None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST)


def field_text(summary: dict[str, Any]) -> str:
    """Return the same as lines of a camera file, with remarks."""
    planes = summary["planes"]
    lines = [
        f"mask_extent_mm: {summary['mask_extent_mm']:g}",
        f"field_curvature: {summary['field_curvature']}  # dioptres",
        *([f"wavefront: {json.dumps(summary['wavefront'])}"] if "wavefront" in summary else []),
        f"# in the corner the blur is {summary['corner_px']:g} px less, by "
        f"{summary['corner_dioptres']:g} dioptres; median errors of the planes:",
        "#    at, m   without   with the fit to the others",
    ]
    row = "# {depth_m:8.4g}{error_without:10.1%}{error:10.1%}".format
    return "\n".join([*lines, *(row(**plane) for plane in planes)])
