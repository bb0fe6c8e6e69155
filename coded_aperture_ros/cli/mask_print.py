"""`coded_aperture mask print`: a page with the mask at true scale, or a holder of it."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

from coded_aperture_ros.cli.command import Command, UsageError, argument, group
from coded_aperture_ros.cli.results import input_files, print_summary
from coded_aperture_ros.cli.rules import excludes, only_with, required
from coded_aperture_ros.core.errors import naming
from coded_aperture_ros.core.files import atomic_output, check_output
from coded_aperture_ros.core.text import rounded
from coded_aperture_ros.design import mask_openings
from coded_aperture_ros.design.diffraction import airy_width_px, diffraction_warning
from coded_aperture_ros.design.holder import (
    Holder,
    HolderConfig,
    bridge_warning,
    holder_mesh,
    mask_holder,
)
from coded_aperture_ros.design.openings import narrowest_bar
from coded_aperture_ros.design.sheet import Sheet, loose_parts_note, mask_sheet
from coded_aperture_ros.design.sheet_files import sheet_dxf, sheet_pdf, sheet_svg
from coded_aperture_ros.design.solid import stl
from coded_aperture_ros.design.vignetting import front_mask_warning, shadow_warning
from coded_aperture_ros.optics import Camera, Mask, load_camera, load_mask
from coded_aperture_ros.optics.pupil import wider_mask_advice

_EXAMPLES = """examples:
  the mask of a camera file, in its size, on a round piece that fits a filter ring of 77 mm:
    coded_aperture mask print --camera config/demo_camera.yaml --outer-mm 74 -o mask.pdf
  Levin's mask, 26 mm wide, with a line that says what it is for:
    coded_aperture mask print levin --extent-mm 26 --label "50 mm f/1.4" -o mask.svg
  the same for a laser whose beam takes away 0.1 mm (needs ezdxf):
    coded_aperture mask print levin --extent-mm 26 --kerf-mm 0.1 -o mask.dxf
  a page with a piece, and a holder of it for a 3-D printer, for a lens of 26.4 mm within its
  filter thread:
    coded_aperture mask print levin --extent-mm 9.6 --lens-mm 26.4 -o mask.pdf
    coded_aperture mask print levin --extent-mm 9.6 --lens-mm 26.4 -o holder.stl
  the mask itself, in a cap that goes over a lens of 39 mm:
    coded_aperture mask print four_hole --extent-mm 8 --lens-mm 39 --cap --print-openings \\
        -o mask.stl
"""
_HOLDER = ".stl"
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
    lens_mm: float | None = argument(
        "inner diameter of the lens's front, measured, where a printed holder goes in: the page "
        "gets a piece that fits into the holder; with -o x.stl the holder itself is written",
        None,
        written="--lens-mm D",
        unit="mm",
        above=0,
    )
    cap: bool = argument(
        "the holder goes over the lens, and --lens-mm is the outer diameter there", False
    )
    print_openings: bool = argument(
        "the holder has the openings of the mask in its floor: no piece is cut", False
    )
    holder: HolderConfig = group("holder (.stl)", HolderConfig())
    output: str = argument(
        "page (.pdf, .svg or .dxf) or holder (.stl) to write",
        written="-o --output FILE",
        is_output=True,
    )
    json: bool = argument("print a summary as JSON", False)


_RULES = (
    required("NAME|FILE", "--camera"),
    excludes("NAME|FILE", "--camera", note="which names the mask"),
    required("--extent-mm", "--camera", note="how wide the mask is, in mm"),
    excludes("--outer-mm", "--lens-mm", note="whose holder takes a piece of its own size"),
    excludes("--rim-mm", "--cap", note="which has none"),
    *(only_with(one, "--lens-mm") for one in ("--cap", "--print-openings", "holder.*")),
)


@dataclasses.dataclass(frozen=True)
class _Drawing:
    """File to write, and what is said of it."""

    data: bytes
    outer_mm: float
    text: str
    holder: Holder | None = None


def run(args: Arguments) -> int:
    """Write the page or the holder; return the exit status."""
    check_output(args.output, input_files(args.mask, camera=args.camera), (*_WRITERS, _HOLDER))
    is_holder = Path(args.output).suffix.lower() == _HOLDER
    _check_usage(args, is_holder)
    camera = load_camera(args.camera) if args.camera else None
    mask = camera.mask if camera is not None else load_mask(str(args.mask))
    extent_mm = args.extent_mm or (camera.mask_extent_mm if camera is not None else 0.0)
    with naming(args.camera or f"mask {args.mask}"):
        if camera is not None:
            camera = dataclasses.replace(camera, mask_extent_mm=extent_mm)
        drawing = (_draw_holder if is_holder else _draw_page)(args, mask, extent_mm)
    with atomic_output(args.output) as path:
        path.write_bytes(drawing.data)
    openings = mask_openings(mask)
    hole_mm = extent_mm * openings.smallest_width
    bar_mm = extent_mm * narrowest_bar(mask)
    if args.print_openings:
        warnings = [bridge_warning(mask, extent_mm, args.holder)]
    else:
        warnings = _cut_warnings(args, mask, camera, hole_mm, bar_mm)
    if camera and drawing.holder:
        warnings.append(shadow_warning(drawing.holder, camera))
    if camera:
        warnings.append(front_mask_warning(camera))
        warnings.append(diffraction_warning(camera, camera.blur_at_infinity_px))
    airy_px = (
        [round(airy_width_px(camera, one.width), 3) for one in openings.each] if camera else None
    )
    summary = {
        "output": args.output,
        "mask": mask.name,
        "extent_mm": extent_mm,
        "outer_mm": drawing.outer_mm,
        "cell_mm": extent_mm / max(mask.transmission.shape),
        "openings": openings.count,
        "smallest_hole_mm": hole_mm,
        "narrowest_bar_mm": rounded(bar_mm, 6),
        "f_number": camera.f_number if camera else None,
        "airy_widths_px": airy_px,
        "open_fraction": mask.open_fraction,
        "loose_parts": openings.loose_parts,
        "holder": dataclasses.asdict(drawing.holder) if drawing.holder else None,
    }
    return print_summary(
        summary, lambda _: drawing.text, as_json=args.json, warnings=filter(None, warnings)
    )


def _check_usage(args: Arguments, is_holder: bool) -> None:
    """Raise `UsageError` for options that the kind of file does not go with."""
    if is_holder and args.lens_mm is None:
        raise UsageError(f"-o {args.output}: needs --lens-mm too (where the holder sits)")
    if is_holder and args.kerf_mm:
        raise UsageError(f"--kerf-mm: not with -o {args.output} (a holder is not cut)")
    if args.print_openings and not is_holder:
        raise UsageError("--print-openings: only with -o x.stl")


def _draw_page(args: Arguments, mask: Mask, extent_mm: float) -> _Drawing:
    piece_mm = args.outer_mm
    if args.lens_mm is not None:
        fitting = mask_holder(mask, extent_mm, args.lens_mm, args.holder, cap=args.cap)
        piece_mm = fitting.piece_mm
    sheet = mask_sheet(mask, extent_mm, piece_mm, args.label, args.kerf_mm)
    hole_mm = extent_mm * mask_openings(mask).smallest_width
    text = (
        f"{args.output}: mask {mask.name}, {extent_mm:g} mm, on a round piece of "
        f"{sheet.outer_mm:g} mm; smallest hole {hole_mm:.2f} mm; print at 100 %, the rulers are "
        "100 mm long"
    )
    return _Drawing(_WRITERS[Path(args.output).suffix.lower()](sheet), sheet.outer_mm, text)


def _draw_holder(args: Arguments, mask: Mask, extent_mm: float) -> _Drawing:
    holder = mask_holder(
        mask,
        extent_mm,
        args.lens_mm or 0.0,
        args.holder,
        cap=args.cap,
        print_openings=args.print_openings,
    )
    mesh = holder_mesh(holder, mask, extent_mm, args.holder)
    what = (
        f"an opening of {holder.opening_mm:.2f} mm, for a round piece of {holder.piece_mm:g} mm"
        if holder.takes_piece
        else f"the openings of mask {mask.name}, {extent_mm:g} mm"
    )
    text = (
        f"{args.output}: holder of {holder.outer_mm:g} mm, {holder.height_mm:g} mm high, with "
        f"{what}; print it with the floor on the bed, without supports; its open side faces the "
        "lens, with the notch up"
    )
    title = f"mask {mask.name}, {extent_mm:g} mm {args.label}"
    return _Drawing(stl(mesh, title), holder.outer_mm, text, holder)


def _cut_warnings(
    args: Arguments, mask: Mask, camera: Camera | None, hole_mm: float, bar_mm: float
) -> list[str]:
    """Warnings of a mask that is hard to cut."""
    warnings = []
    wider = "a wider mask"
    if camera is not None:
        wider = wider_mask_advice(mask, camera.mask_extent_mm, camera.pupil_mm)
    if loose_parts := mask_openings(mask).loose_parts:
        warnings.append(f"mask {mask.name}: {loose_parts_note(loose_parts)}")
    for what, width_mm in (("opening", hole_mm), ("bar between openings", bar_mm)):
        if width_mm < args.smallest_cut_mm:
            warnings.append(
                f"mask {mask.name}: the narrowest {what}, {width_mm:.2f} mm, is less than the "
                f"{args.smallest_cut_mm:g} mm that can be cut: take {wider}, or have it printed on "
                "film"
            )
    return warnings


COMMAND = Command(
    Arguments,
    run,
    description="Draw a mask on an A4 page at true scale, with rulers in mm, cut lines and a "
    "mark for the way it sits in the lens; DXF has the cut lines alone. STL has a holder of the "
    "mask for a 3-D printer, in mm. Masks with names: "
    "levin, two_hole, three_hole, four_hole, annulus, veeraraghavan, zhou, mura, disc, "
    "four_wide, three_wide.",
    examples=_EXAMPLES,
    rules=_RULES,
)
