"""Page with a mask at true scale, to print, glue to cardboard and cut out."""

import dataclasses
import math

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.openings import Outline, Point, mask_openings, mask_outlines, recut
from coded_aperture_ros.optics import Mask

# A4, and what of it every printer reaches.
WIDTH_MM = 210.0
HEIGHT_MM = 297.0
_MAX_DIAMETER_MM = 170.0
_TOP_MM = 62.0
# Cardboard left between the openings and the edge of the piece: by default, and at least.
_MARGIN_MM = 5.0
_MIN_MARGIN_MM = 0.5
_CIRCLE_CORNERS = 360
_RULER_MM = 100
# Where the rulers begin; printers may stretch the two directions differently.
_ACROSS = (40.0, 285.0)
_DOWN = (10.0, 170.0)


@dataclasses.dataclass(frozen=True)
class Shape:
    """Area or lines; lengths in mm from the page's upper left corner, y down."""

    outlines: list[Outline]  # an area is what an odd number of them encloses
    colour: str  # as #rrggbb
    kind: str = "mark"  # or mask, hole, rim, ruler: for those who read the file
    filled: bool = False  # an area; else lines of `width_mm`
    closed: bool = True  # whether the outlines' ends are joined
    dashed: bool = False
    width_mm: float = 0.1


@dataclasses.dataclass(frozen=True)
class Text:
    """Line of text whose baseline begins, or has its middle, at `at`."""

    at: Point
    text: str
    height_mm: float = 3.6
    centred: bool = False


@dataclasses.dataclass(frozen=True)
class Sheet:
    """Content of the page, in the order of drawing; `outer_mm` is the round piece's diameter."""

    title: str
    outer_mm: float
    shapes: list[Shape]
    texts: list[Text]


def mask_sheet(
    mask: Mask,
    extent_mm: float,
    outer_mm: float | None = None,
    label: str = "",
    kerf_mm: float = 0.0,
) -> Sheet:
    """Page with a mask at true scale, rulers, cut lines and the orientation in the lens.

    The printed side is what the sensor would see: held towards the sensor with the mark up, the PSF
    of a point beyond the focus is the mask as it is stored.

    Parameters
    ----------
    mask : Mask
    extent_mm : float
        Outer extent of the mask's grid, as in the camera file.
    outer_mm : float, optional
        Diameter of the round piece to cut out; by default there are 5 mm around the openings.
    label : str, optional
        A line of text, such as the name of the lens.
    kerf_mm : float, optional
        Width of the cut, which the openings are narrower by.

    Raises
    ------
    InputError
        If the mask does not fit the page, or the openings do not fit the round piece.
    """
    if not 0 < extent_mm < math.inf:
        raise InputError(f"mask size: expected more than 0 mm, got {extent_mm:g} mm")
    cut = recut(mask, -kerf_mm / extent_mm) if kerf_mm else mask
    outlines = [[(x * extent_mm, y * extent_mm) for x, y in one] for one in mask_outlines(cut)]
    reach_mm = max(math.hypot(x, y) for outline in outlines for x, y in outline)
    if outer_mm is None:
        outer_mm = math.ceil(2 * (reach_mm + _MARGIN_MM))
    if not outer_mm >= 2 * (reach_mm + _MIN_MARGIN_MM):
        raise InputError(
            f"outer diameter {outer_mm:g} mm: the openings reach {2 * reach_mm:.1f} mm across, use "
            f"at least {2 * (reach_mm + _MIN_MARGIN_MM):.1f} mm or a smaller mask"
        )
    if outer_mm > _MAX_DIAMETER_MM:
        raise InputError(
            f"the mask with its rim is {outer_mm:.4g} mm wide and does not fit on an A4 page: use "
            f"at most {_MAX_DIAMETER_MM:g} mm"
        )
    openings = mask_openings(mask)
    count = "1 opening" if openings.count == 1 else f"{openings.count} openings"
    title = f"Mask {mask.name}, {extent_mm:g} mm"
    notes = [
        label,
        "Print at 100 %, without fitting to the page: both rulers must be 100 mm long.",
        f"{count}; the narrowest takes a disc of {openings.smallest_width * extent_mm:.2f} mm; "
        f"{100 * mask.open_fraction:.0f} % of the square is open.",
        "Glue to thin black cardboard, cut out the white openings and the dashed rim.",
        "This side faces the sensor, with the triangle up.",
        f"Lines lie {kerf_mm / 2:g} mm within the openings: the cut is wider." if kerf_mm else "",
        loose_parts_note(openings.loose_parts) if openings.loose_parts else "",
    ]
    rulers = [_ruler(_ACROSS, down=False), _ruler(_DOWN, down=True)]
    return Sheet(
        title,
        outer_mm,
        [*_piece(outlines, outer_mm, reach_mm), *(shape for shape, _ in rulers)],
        [
            Text((20.0, 20.0), title, 6.0),
            *(Text((20.0, 28.0 + 5.0 * k), line) for k, line in enumerate(filter(None, notes))),
            *(number for _, numbers in rulers for number in numbers),
        ],
    )


def loose_parts_note(count: int) -> str:
    """Note about closed parts that hang on nothing."""
    parts = "One closed part hangs" if count == 1 else f"{count} closed parts hang"
    return f"{parts} on nothing: print on film instead, or leave thin bridges."


def _piece(outlines: list[Outline], outer_mm: float, reach_mm: float) -> list[Shape]:
    """Black piece with its cut lines, and triangles that point up."""
    radius_mm = outer_mm / 2
    x = WIDTH_MM / 2
    y = _TOP_MM + radius_mm
    holes = [[(x + dx, y + dy) for dx, dy in outline] for outline in outlines]
    angles = [2 * math.pi * k / _CIRCLE_CORNERS for k in range(_CIRCLE_CORNERS)]
    rim = [(x + radius_mm * math.cos(one), y + radius_mm * math.sin(one)) for one in angles]
    # Above the piece, and, where there is room, on it.
    triangles = [(y - radius_mm - 4.5, 3.0, "#000000")]
    room_mm = radius_mm - reach_mm - 1.0
    if room_mm > 0.5:
        triangles.append((y - radius_mm + 0.5, min(3.0, room_mm), "#ffffff"))
    return [
        Shape([rim, *holes], "#000000", "mask", filled=True),
        *(Shape([hole], "#d00000", "hole") for hole in holes),
        Shape([rim], "#d00000", "rim", dashed=True, width_mm=0.2),
        *(
            Shape([[(x, top), (x + high / 2, top + high), (x - high / 2, top + high)]], colour,
                  filled=True)
            for top, high, colour in triangles
        ),
    ]  # fmt: skip


def _ruler(start: Point, *, down: bool) -> tuple[Shape, list[Text]]:
    """Ruler with a tick each millimetre, and a number each centimetre."""
    x, y = start

    def at(along: float, beside: float) -> Point:
        return (x + beside, y + along) if down else (x + along, y - beside)

    lines = [[at(0, 0), at(_RULER_MM, 0)]]
    numbers = []
    for mm in range(_RULER_MM + 1):
        lines.append([at(mm, 0), at(mm, 4.0 if mm % 10 == 0 else 3.0 if mm % 5 == 0 else 2.0)])
        if mm % 10 == 0:
            where = at(mm + 0.9, 5.0) if down else at(mm, 5.5)
            text = f"{mm} mm" if mm == _RULER_MM else f"{mm}"
            numbers.append(Text(where, text, 2.5, centred=not down))
    return Shape(lines, "#000000", "ruler", closed=False), numbers
