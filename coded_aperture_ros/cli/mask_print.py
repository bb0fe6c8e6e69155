"""`coded_aperture mask print`: a page with the mask at true scale, to be cut out."""

import dataclasses
import logging
from collections.abc import Callable
from pathlib import Path

from coded_aperture_ros.cli.command import Command, argument
from coded_aperture_ros.cli.results import input_files, print_summary
from coded_aperture_ros.cli.rules import excludes, required
from coded_aperture_ros.core.errors import naming
from coded_aperture_ros.core.files import atomic_output, check_output
from coded_aperture_ros.core.text import rounded
from coded_aperture_ros.design import mask_openings
from coded_aperture_ros.design.diffraction import airy_width_px, diffraction_warning
from coded_aperture_ros.design.openings import Openings, narrowest_bar
from coded_aperture_ros.design.sheet import Sheet, loose_parts_note, mask_sheet
from coded_aperture_ros.design.sheet_files import sheet_dxf, sheet_pdf, sheet_svg
from coded_aperture_ros.optics import Camera, Mask, load_camera, load_mask
from coded_aperture_ros.optics.pupil import wider_mask_advice

_EXAMPLES = """examples:
  the mask of a camera file, in its size, on a round piece that fits a filter ring of 77 mm:
    coded_aperture mask print --camera config/demo_camera.yaml --outer-mm 74 -o mask.pdf
  Levin's mask, 26 mm wide, with a line that says what it is for:
    coded_aperture mask print levin --extent-mm 26 --label "50 mm f/1.4" -o mask.svg
  the same for a laser whose beam takes away 0.1 mm (needs ezdxf):
    coded_aperture mask print levin --extent-mm 26 --kerf-mm 0.1 -o mask.dxf
"""
_WRITERS: dict[str, Callable[[Sheet], bytes]] = {
    ".pdf": sheet_pdf,
    ".svg": lambda sheet: sheet_svg(sheet).encode(),
    ".dxf": sheet_dxf,
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments:
    """Arguments of `mask print`."""

    mask: str | None = argument("name or file (PNG, .npy) of the mask", None, written="NAME|FILE")
    camera: str | None = argument(
        "camera file whose mask and mask size are taken", None, written="--camera YAML"
    )
    extent_mm: float | None = argument(
        "outer width of the mask's grid; needed without --camera",
        None,
        written="--extent-mm M",
        unit="mm",
        above=0,
    )
    outer_mm: float | None = argument(
        "diameter of the round piece that goes into the lens (default: 5 mm of rim around the "
        "openings)",
        None,
        written="--outer-mm D",
        unit="mm",
        above=0,
    )
    smallest_cut_mm: float = argument(
        "warn of openings, and bars between them, that are narrower",
        0.3,
        written="--smallest-cut-mm MM",
        unit="mm",
        above=0,
    )
    kerf_mm: float = argument(
        "width of the cut: lines lie half of it within the openings",
        0.0,
        written="--kerf-mm MM",
        unit="mm",
        minimum=0,
    )
    label: str = argument("a line to print on the page", "", written="--label TEXT")
    output: str = argument(
        "page to write (.pdf, .svg or .dxf)", written="-o --output FILE", is_output=True
    )
    json: bool = argument("print a summary as JSON", False)


_RULES = (
    required("NAME|FILE", "--camera"),
    excludes("NAME|FILE", "--camera", note="which names the mask"),
    required("--extent-mm", "--camera", note="how wide the mask is, in mm"),
)


def run(args: Arguments) -> int:
    """Write the page; return the exit status."""
    check_output(args.output, input_files(args.mask, camera=args.camera), tuple(_WRITERS))
    camera = load_camera(args.camera) if args.camera else None
    mask = camera.mask if camera is not None else load_mask(str(args.mask))
    extent_mm = args.extent_mm or (camera.mask_extent_mm if camera is not None else 0.0)
    with naming(args.camera or f"mask {args.mask}"):
        if camera is not None:
            camera = dataclasses.replace(camera, mask_extent_mm=extent_mm)
        sheet = mask_sheet(mask, extent_mm, args.outer_mm, args.label, args.kerf_mm)
    data = _WRITERS[Path(args.output).suffix.lower()](sheet)
    with atomic_output(args.output) as path:
        path.write_bytes(data)
    openings = mask_openings(mask)
    hole_mm = extent_mm * openings.smallest_width
    bar_mm = extent_mm * narrowest_bar(mask)
    for warning in _warnings(args, mask, openings, camera, hole_mm, bar_mm):
        logging.warning(warning)
    airy_px = (
        [round(airy_width_px(camera, one.width), 3) for one in openings.each] if camera else None
    )
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
    text = (
        f"{args.output}: mask {mask.name}, {extent_mm:g} mm, on a round piece of "
        f"{sheet.outer_mm:g} mm; smallest hole {hole_mm:.2f} mm; print at 100 %, the rulers are "
        "100 mm long"
    )
    return print_summary(summary, lambda _: text, as_json=args.json)


def _warnings(
    args: Arguments,
    mask: Mask,
    openings: Openings,
    camera: Camera | None,
    hole_mm: float,
    bar_mm: float,
) -> list[str]:
    """Return what the mask is not good for."""
    warnings = []
    wider = "a wider mask"
    if camera is not None:
        wider = wider_mask_advice(mask, camera.mask_extent_mm, camera.pupil_mm)
    if openings.loose_parts:
        warnings.append(f"mask {mask.name}: {loose_parts_note(openings.loose_parts)}")
    for what, width_mm in (("opening", hole_mm), ("bar between openings", bar_mm)):
        if width_mm < args.smallest_cut_mm:
            warnings.append(
                f"mask {mask.name}: the narrowest {what}, {width_mm:.2f} mm, is less than the "
                f"{args.smallest_cut_mm:g} mm that can be cut: take "
                f"{wider}, or have it printed on "
                "film"
            )
    if camera and (warning := diffraction_warning(camera, camera.blur_at_infinity_px)):
        warnings.append(warning)
    return warnings


COMMAND = Command(
    Arguments,
    run,
    description="Draw a mask on an A4 page at true scale, with rulers in mm, cut lines and a "
    "mark for the way it sits in the lens; DXF has the cut lines alone. Masks with names: "
    "levin, two_hole, three_hole, four_hole, annulus, veeraraghavan, zhou, mura, disc, "
    "four_wide, three_wide.",
    examples=_EXAMPLES,
    rules=_RULES,
)
