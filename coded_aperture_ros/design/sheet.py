"""A page with a mask at true scale, to be printed, glued to cardboard and cut out."""

import dataclasses
import math
from collections.abc import Sequence

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.design.openings import openings_of
from coded_aperture_ros.design.outline import Point, outlines_of
from coded_aperture_ros.optics import Mask

# A4, and what of it every printer reaches.
WIDTH_MM, HEIGHT_MM = 210.0, 297.0
_LARGEST_MM = 170.0
_TOP_MM = 62.0
_RULER_MM = 100
# Cardboard left between the openings and the rim: by default, and at least.
_RIM_MM = 5.0
_LEAST_RIM_MM = 0.5
_HAIRLINE_MM = 0.1
_CIRCLE_CORNERS = 360


@dataclasses.dataclass(frozen=True)
class Shape:
    """An area or a line; lengths in mm from the page's upper left corner, y down.

    Attributes
    ----------
    outlines : list of list of (float, float)
        An area is what an odd number of outlines encloses.
    fill, stroke : str
        Colours as `#rrggbb`; empty for none.
    closed : bool
        Whether the outlines' ends are joined.
    dashed : bool
    kind : str
        What it is, for those who read the file: `mask`, `hole`, `rim`, `ruler` or `mark`.
    """

    outlines: list[list[Point]]
    fill: str = ""
    stroke: str = ""
    width_mm: float = _HAIRLINE_MM
    closed: bool = True
    dashed: bool = False
    kind: str = "mark"


@dataclasses.dataclass(frozen=True)
class Text:
    """A line of text whose baseline begins, or has its middle, at `at`."""

    at: Point
    text: str
    height_mm: float = 3.6
    centred: bool = False


@dataclasses.dataclass(frozen=True)
class Sheet:
    """Everything on the page, in the order of drawing.

    Attributes
    ----------
    title : str
    outer_mm : float
        Diameter of the round piece.
    shapes : list of Shape
    texts : list of Text
    """

    title: str
    outer_mm: float
    shapes: list[Shape]
    texts: list[Text]


def mask_sheet(
    mask: Mask, extent_mm: float, outer_mm: float | None = None, label: str = ""
) -> Sheet:
    """Lay out a mask at true scale, with a ruler, cut lines and the way it sits in the lens.

    The printed side is what the sensor would see: held towards the sensor with the mark up, the
    PSF of a point beyond the focus is the mask as it is stored.

    Parameters
    ----------
    mask : Mask
    extent_mm : float
        Outer extent of the mask's grid, as in the camera file.
    outer_mm : float, optional
        Diameter of the round piece to cut out; by default 5 mm of rim around the openings.
    label : str, optional
        A line of text, say the lens that it is for.

    Raises
    ------
    InputError
        If the mask does not fit the page, or the openings not into the round piece.
    """
    if not 0 < extent_mm < math.inf:
        raise InputError(f"mask size: expected more than 0 mm, got {extent_mm:g} mm")
    outlines = [[(x * extent_mm, y * extent_mm) for x, y in one] for one in outlines_of(mask)]
    reach_mm = max(math.hypot(x, y) for outline in outlines for x, y in outline)
    if outer_mm is None:
        outer_mm = math.ceil(2 * (reach_mm + _RIM_MM))
    if not outer_mm >= 2 * (reach_mm + _LEAST_RIM_MM):
        raise InputError(
            f"outer diameter {outer_mm:g} mm: the openings reach {2 * reach_mm:.1f} mm across, use "
            f"at least {2 * (reach_mm + _LEAST_RIM_MM):.1f} mm or a smaller mask"
        )
    if outer_mm > _LARGEST_MM:
        raise InputError(
            f"the mask with its rim is {outer_mm:.4g} mm wide and does not fit on an A4 page: use "
            f"at most {_LARGEST_MM:g} mm"
        )
    openings = openings_of(mask)
    narrowest_mm = openings.smallest_width * extent_mm
    title = f"Mask {mask.name}, {extent_mm:g} mm"
    notes = [
        label,
        "Print at 100 %, without fitting to the page: both rulers must be 100 mm long.",
        f"{_openings(openings.count)}; the narrowest takes a disc of {narrowest_mm:.2f} mm; "
        f"{100 * mask.open_fraction:.0f} % of the square is open.",
        "Glue to thin black cardboard, cut out the white openings and the dashed rim.",
        "This side faces the sensor, with the triangle up.",
    ]
    if openings.loose_parts:
        notes.append(loose_parts_note(openings.loose_parts))
    centre = WIDTH_MM / 2, _TOP_MM + outer_mm / 2
    return Sheet(
        title,
        outer_mm,
        [*_mask_shapes(outlines, centre, outer_mm, reach_mm), *_rulers()],
        [
            Text((20.0, 20.0), title, 6.0),
            *(Text((20.0, 28.0 + 5.0 * k), line) for k, line in enumerate(filter(None, notes))),
            *_ruler_numbers(),
        ],
    )


def loose_parts_note(count: int) -> str:
    """Say what to do about closed parts that hang on nothing."""
    parts = "One closed part hangs" if count == 1 else f"{count} closed parts hang"
    return f"{parts} on nothing: print on film instead, or leave thin bridges."


def _openings(count: int) -> str:
    return "1 opening" if count == 1 else f"{count} openings"


def _mask_shapes(
    outlines: Sequence[Sequence[Point]], centre: Point, outer_mm: float, reach_mm: float
) -> list[Shape]:
    x, y = centre
    holes = [[(x + dx, y + dy) for dx, dy in outline] for outline in outlines]
    rim = _circle(centre, outer_mm / 2)
    shapes = [
        Shape([rim, *holes], fill="#000000", kind="mask"),
        *(Shape([hole], stroke="#d00000", kind="hole") for hole in holes),
        Shape([rim], stroke="#d00000", width_mm=0.2, dashed=True, kind="rim"),
        # Above the piece, and, where there is room, on it.
        Shape([_triangle((x, y - outer_mm / 2 - 4.5), 3.0)], fill="#000000"),
    ]
    room_mm = outer_mm / 2 - reach_mm - 1.0
    if room_mm > 0.5:
        top = x, y - outer_mm / 2 + 0.5
        shapes.append(Shape([_triangle(top, min(3.0, room_mm))], fill="#ffffff"))
    return shapes


def _circle(centre: Point, radius_mm: float) -> list[Point]:
    angles = [2 * math.pi * k / _CIRCLE_CORNERS for k in range(_CIRCLE_CORNERS)]
    return [
        (centre[0] + radius_mm * math.cos(angle), centre[1] + radius_mm * math.sin(angle))
        for angle in angles
    ]


def _triangle(top: Point, height_mm: float) -> list[Point]:
    x, y = top
    return [(x, y), (x + height_mm / 2, y + height_mm), (x - height_mm / 2, y + height_mm)]


# Where the rulers begin; printers may stretch the two directions differently.
_ACROSS = (40.0, 285.0)
_DOWN = (10.0, 170.0)


def _rulers() -> list[Shape]:
    shapes = []
    for (x, y), down in ((_ACROSS, False), (_DOWN, True)):
        end = (x, y + _RULER_MM) if down else (x + _RULER_MM, y)
        shapes.append(_ruler_line([(x, y), end]))
        for mm in range(_RULER_MM + 1):
            length = 4.0 if mm % 10 == 0 else 3.0 if mm % 5 == 0 else 2.0
            tick = (
                [(x, y + mm), (x + length, y + mm)] if down else [(x + mm, y), (x + mm, y - length)]
            )
            shapes.append(_ruler_line(tick))
    return shapes


def _ruler_line(points: list[Point]) -> Shape:
    return Shape([points], stroke="#000000", closed=False, kind="ruler")


def _ruler_numbers() -> list[Text]:
    numbers = []
    for mm in range(0, _RULER_MM + 1, 10):
        unit = " mm" if mm == _RULER_MM else ""
        across = _ACROSS[0] + mm, _ACROSS[1] - 5.5
        numbers.append(Text(across, f"{mm}{unit}", 2.5, centred=True))
        down = _DOWN[0] + 5.0, _DOWN[1] + mm + 0.9
        numbers.append(Text(down, f"{mm}{unit}", 2.5))
    return numbers
