"""`coded_aperture mask print`: a page with the mask at true scale, to be cut out."""

import argparse
import dataclasses
import logging
import math
from pathlib import Path
from typing import Any

from coded_aperture_ros.cli.checks import check_output, inputs_of
from coded_aperture_ros.cli.measuring import rounded, tell
from coded_aperture_ros.cli.options import add_options, mask_of, written_name
from coded_aperture_ros.core.errors import naming

_EPILOG = """examples:
  the mask of a camera file, in its size, on a round piece that fits a filter ring of 77 mm:
    coded_aperture mask print --camera config/demo_camera.yaml --outer-mm 74 -o mask.pdf
  Levin's mask, 26 mm wide, with a line that says what it is for:
    coded_aperture mask print levin --extent-mm 26 --label "50 mm f/1.4" -o mask.svg
  the same for a laser whose beam takes away 0.1 mm (needs ezdxf):
    coded_aperture mask print levin --extent-mm 26 --kerf-mm 0.1 -o mask.dxf
"""


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the program's parser."""
    parser = subparsers.add_parser(
        "print",
        help="draw a mask at true scale, with a ruler and cut lines (PDF, SVG or DXF)",
        description="Draw a mask on an A4 page at true scale, with rulers in mm, cut lines and a "
        "mark for the way it sits in the lens; DXF has the cut lines alone. Masks with names: "
        "levin, two_hole, three_hole, four_hole, annulus, veeraraghavan, zhou, mura, disc, "
        "four_wide, three_wide.",
        epilog=_EPILOG,
    )
    what = "name or file (PNG, .npy) of the mask"
    parser.add_argument("mask", nargs="?", metavar="NAME|FILE", help=what)
    add_options(parser, {"--camera YAML": "camera file whose mask and mask size are taken"})
    lengths = {
        "--extent-mm M": "outer width of the mask's grid; needed without --camera",
        "--outer-mm D": "diameter of the round piece that goes into the lens (default: 5 mm of "
        "rim around the openings)",
    }
    add_options(parser, lengths, type=float)
    least = {
        "--smallest-cut-mm MM": "warn of openings, and bars between them, that are narrower "
        "(default %(default)s)"
    }
    add_options(parser, least, type=float, default=0.3)
    kerf = "width of the cut: lines lie half of it within the openings (default 0)"
    add_options(parser, {"--kerf-mm MM": kerf}, type=float, default=0.0)
    add_options(parser, {"--label TEXT": "a line to print on the page"}, default="")
    add_options(parser, {"-o --output FILE": "page to write (.pdf, .svg or .dxf)"}, required=True)
    add_options(parser, {"--json": "print a summary as JSON"})


def run(args: argparse.Namespace) -> int:
    """Run the sub-command; return its exit status."""
    from coded_aperture_ros.core.files import atomic_output
    from coded_aperture_ros.design import mask_openings
    from coded_aperture_ros.design.diffraction import airy_width_px, diffraction_warning
    from coded_aperture_ros.design.openings import narrowest_bar
    from coded_aperture_ros.design.sheet import loose_parts_note, mask_sheet
    from coded_aperture_ros.design.sheet_files import sheet_dxf, sheet_pdf, sheet_svg
    from coded_aperture_ros.optics import load_camera

    _check_usage(args)
    check_output(args.output, inputs_of(args, "camera", "mask"), (".pdf", ".svg", ".dxf"))
    camera = args.camera and load_camera(args.camera)
    mask = camera.mask if camera else mask_of(args.mask)
    extent_mm = args.extent_mm or camera.mask_extent_mm
    camera = camera and dataclasses.replace(camera, mask_extent_mm=extent_mm)
    with naming(args.camera or f"mask {args.mask}"):
        sheet = mask_sheet(mask, extent_mm, args.outer_mm, args.label, args.kerf_mm)
    written = {
        ".pdf": sheet_pdf,
        ".dxf": sheet_dxf,
        ".svg": lambda sheet: sheet_svg(sheet).encode(),
    }
    data = written[Path(args.output).suffix.lower()](sheet)
    with atomic_output(args.output) as path:
        path.write_bytes(data)
    openings = mask_openings(mask)
    if openings.loose_parts:
        logging.warning("mask %s: %s", mask.name, loose_parts_note(openings.loose_parts))
    hole_mm, bar_mm = (extent_mm * one for one in (openings.smallest_width, narrowest_bar(mask)))
    for what, width_mm in (("opening", hole_mm), ("bar between openings", bar_mm)):
        if width_mm < args.smallest_cut_mm:
            logging.warning(
                "mask %s: the narrowest %s, %.2f mm, is less than the %g mm that can be cut: take "
                "a larger mask, or have it printed on film",
                *(mask.name, what, width_mm, args.smallest_cut_mm),
            )
    if camera and (warning := diffraction_warning(camera, camera.blur_at_infinity_px)):
        logging.warning(warning)
    airy_px = [round(airy_width_px(camera, one), 3) for one in openings.each] if camera else None
    summary = {
        "output": args.output,
        "mask": mask.name,
        "extent_mm": extent_mm,
        "outer_mm": sheet.outer_mm,
        "cell_mm": extent_mm / max(mask.transmission.shape),
        "openings": openings.count,
        "smallest_hole_mm": hole_mm,
        "narrowest_bar_mm": rounded(bar_mm, 6),
        "f_number": camera.f_number if camera else None,
        "airy_widths_px": airy_px,
        "open_fraction": mask.open_fraction,
        "loose_parts": openings.loose_parts,
    }
    return tell(
        args,
        summary,
        lambda found: (
            f"{args.output}: mask {mask.name}, {extent_mm:g} mm, on a round piece of "
            f"{sheet.outer_mm:g} mm; smallest hole {found['smallest_hole_mm']:.2f} mm; print at "
            "100 %, the rulers are 100 mm long"
        ),
    )


def _check_usage(args: argparse.Namespace) -> None:
    if (args.mask is None) == (args.camera is None):
        args.usage_error("give either a mask's name or file, or --camera")
    if args.mask is not None and args.extent_mm is None:
        args.usage_error("--extent-mm is needed: how wide the mask is, in mm")
    for name in ("extent_mm", "outer_mm", "smallest_cut_mm", "kerf_mm"):
        value = getattr(args, name)
        if name == "kerf_mm" and value == 0:
            continue
        if value is not None and not 0 < value < math.inf:
            args.usage_error(f"{written_name(name)}: expected more than 0 mm, got {value:g}")
