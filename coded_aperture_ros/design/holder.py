"""Holder of a mask in front of a lens, to be printed; or the mask itself, where cells are large."""

import dataclasses
import math

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option
from coded_aperture_ros.design.openings import cells_to_cut, mask_openings, narrowest_bar
from coded_aperture_ros.design.solid import Mesh, Plan, circle, solid, triangles_between
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.optics.pupil import openings_diameter

# A line of plastic is as wide as the nozzle; a bar or ledge that holds, or an opening that stays
# open, is two lines wide.
_LINES = 2
# Curved openings are drawn in cells of this part of the nozzle.
_FINENESS = 4
# Mark of the upper side: a notch as deep as this, or half of what it is in.
_NOTCH_MM = 1.2
_LARGEST_MM = 200.0  # of the bed of a usual printer


@dataclasses.dataclass(frozen=True)
class HolderConfig:
    """What a holder is made like, for a lens and a printer."""

    fit_mm: float = option(
        0.2, "Play between parts, in diameter.", unit="mm", within=(0.0, 2.0), daily=True
    )
    depth_mm: float = option(
        3.0, "How far it reaches into the lens, or over it.", unit="mm", within=(0.5, 50.0)
    )
    rim_mm: float = option(
        2.0, "Rim that stays outside the lens; 0: none.", unit="mm", within=(0.0, 20.0)
    )
    wall_mm: float = option(1.2, "Thickness of the round wall.", unit="mm", within=(0.4, 10.0))
    floor_mm: float = option(
        0.8, "Thickness of the floor: what holds the mask, or is it.", unit="mm", within=(0.2, 10.0)
    )
    margin_mm: float = option(
        1.0,
        "Opening of the holder, wider than the circle around the mask's openings.",
        unit="mm",
        within=(0.0, 50.0),
    )
    nozzle_mm: float = option(0.4, "Width of the printer's nozzle.", unit="mm", within=(0.1, 1.0))

    def __post_init__(self) -> None:
        check_options(self)


@dataclasses.dataclass(frozen=True)
class Holder:
    """Measures of a holder, mm; diameters, from the inside to the outside, and heights.

    The floor stands on z = 0, which looks at the scene; the wall rises from it to the lens.
    """

    opening_mm: float  # 0: the floor has the openings of the mask
    pocket_mm: float
    wall_mm: float  # outer diameter of the wall
    outer_mm: float
    floor_mm: float
    height_mm: float
    piece_mm: float  # diameter of the round piece to cut; 0: none

    @property
    def takes_piece(self) -> bool:
        """Whether a cut mask lies in it."""
        return self.opening_mm > 0

    @property
    def notch_mm(self) -> float:
        """Depth of the notch that marks the upper side."""
        inside_mm = self.wall_mm if self.outer_mm > self.wall_mm else self.pocket_mm
        return min(_NOTCH_MM, (self.outer_mm - inside_mm) / 4)


def mask_holder(
    mask: Mask,
    extent_mm: float,
    lens_mm: float,
    config: HolderConfig | None = None,
    *,
    cap: bool = False,
    print_openings: bool = False,
) -> Holder:
    """Measures of a holder for a lens.

    Parameters
    ----------
    mask : Mask
    extent_mm : float
        Outer extent of the mask's grid, as in the camera file.
    lens_mm : float
        Inner diameter of the front of the lens, where the holder goes in; with `cap` its outer
        diameter, where the holder goes over it.
    config : HolderConfig, optional
    cap : bool, optional
    print_openings : bool, optional
        The floor has the openings of the mask, instead of one that a cut mask lies on.

    Raises
    ------
    InputError
        If the mask does not fit the lens, or the printer cannot make it.

    Examples
    --------
    >>> holder = mask_holder(Mask.named("levin"), 9.6, 26.4)
    >>> holder.outer_mm, holder.height_mm, round(holder.opening_mm, 2)
    (30.4, 3.8, 12.38)
    """
    config = config or HolderConfig()
    if not 0 < lens_mm <= _LARGEST_MM:
        raise InputError(
            f"lens diameter: expected more than 0 and at most {_LARGEST_MM:g} mm, got {lens_mm:g}"
        )
    _check_walls(config)
    grid = math.hypot(*mask.transmission.shape) / max(mask.transmission.shape)
    held_mm = extent_mm * (grid if print_openings else openings_diameter(mask))
    pocket_mm = lens_mm + config.fit_mm if cap else lens_mm - config.fit_mm - 2 * config.wall_mm
    room_mm = pocket_mm - config.margin_mm - 2 * _LINES * config.nozzle_mm
    if held_mm > room_mm:
        raise InputError(
            f"{'grid of the mask' if print_openings else 'openings of the mask'}: {held_mm:.1f} mm "
            f"across; a holder for {lens_mm:g} mm has room for {max(room_mm, 0):.1f} mm: use a "
            "smaller mask, margin or wall"
        )
    if print_openings:
        _check_printable(mask, extent_mm, config.nozzle_mm)
    wall_mm = pocket_mm + 2 * config.wall_mm
    return Holder(
        opening_mm=0.0 if print_openings else held_mm + config.margin_mm,
        pocket_mm=round(pocket_mm, 3),
        wall_mm=round(wall_mm, 3),
        outer_mm=round(wall_mm if cap or not config.rim_mm else lens_mm + 2 * config.rim_mm, 3),
        floor_mm=config.floor_mm,
        height_mm=round(config.floor_mm + config.depth_mm, 3),
        piece_mm=0.0 if print_openings else round(pocket_mm - config.fit_mm, 3),
    )


def _check_walls(config: HolderConfig) -> None:
    least_mm = _LINES * config.nozzle_mm
    for what, width_mm in (("wall", config.wall_mm), ("rim", config.rim_mm or math.inf)):
        if width_mm < least_mm * (1 - 1e-6):
            raise InputError(
                f"{what} of {width_mm:g} mm: a nozzle of {config.nozzle_mm:g} mm makes "
                f"{least_mm:g} mm or more"
            )


def bridge_warning(mask: Mask, extent_mm: float, config: HolderConfig) -> str:
    """Warning of bridges in a printed mask, and of the light that they cost; empty without."""
    if not _touching(_printed_cells(mask, extent_mm, config.nozzle_mm)).any():
        return ""
    cells = printable_cells(mask, extent_mm, config.nozzle_mm)
    lost = 1 - cells.open_fraction / mask.open_fraction
    return (
        f"mask {mask.name}: bridges where openings touch at a corner close {100 * lost:.1f} % of "
        "what is open: learn the bank from pictures of planes, not from the camera file"
    )


def _check_printable(mask: Mask, extent_mm: float, line_mm: float) -> None:
    least_mm = _LINES * line_mm
    found = ("opening", mask_openings(mask).smallest_width), ("bar", narrowest_bar(mask))
    for what, width in found:
        if extent_mm * width < least_mm * (1 - 1e-6):
            raise InputError(
                f"narrowest {what} of the mask: {extent_mm * width:.2f} mm, less than the "
                f"{least_mm:g} mm that a nozzle of {line_mm:g} mm makes: print the holder alone "
                "and cut the mask, or use a finer nozzle"
            )


def holder_mesh(
    holder: Holder, mask: Mask, extent_mm: float, config: HolderConfig | None = None
) -> Mesh:
    """Surface of a holder.

    Seen from the lens (from above, z up) the mask is as stored, with the notch at the top: what is
    printed looks at the sensor with the side that was up.

    Parameters
    ----------
    holder : Holder
        From `mask_holder`.
    mask : Mask
    extent_mm : float
    config : HolderConfig, optional
        The same as for `mask_holder`.

    Raises
    ------
    InputError
        If parts of a mask that is printed hang on nothing.

    Examples
    --------
    >>> levin = Mask.named("levin")
    >>> mesh = holder_mesh(mask_holder(levin, 9.6, 26.4), levin, 9.6)
    >>> np.ptp(mesh.vertices, axis=0).round(1).tolist()
    [30.4, 30.4, 3.8]
    """
    line_mm = (config or HolderConfig()).nozzle_mm
    if holder.takes_piece:
        plan = Plan(circle(holder.opening_mm), np.zeros((0, 3), np.intp), np.zeros(0))
        inner = np.arange(len(plan.points))
    else:
        plan, inner = _grid_plan(printable_cells(mask, extent_mm, line_mm), holder.floor_mm)
    rings = [(holder.pocket_mm, holder.floor_mm), (holder.wall_mm, holder.height_mm)]
    if holder.outer_mm > holder.wall_mm:
        rings.append((holder.outer_mm, holder.floor_mm))
    for diameter_mm, height_mm in rings:
        notch_mm = holder.notch_mm if diameter_mm == holder.outer_mm else 0.0
        plan, inner = _with_ring(plan, inner, circle(diameter_mm, notch_mm), height_mm)
    return solid(plan)


@dataclasses.dataclass(frozen=True, eq=False)
class Cells:
    """Closed cells of a printed mask, of any widths, around the middle."""

    closed: BoolArray  # [n, m], as the mask is stored
    x_mm: DoubleArray  # [m + 1], edges from the left
    y_mm: DoubleArray  # [n + 1], edges from above, y up

    @property
    def open_fraction(self) -> float:
        """Share of the grid that is open."""
        areas = np.abs(np.outer(np.diff(self.y_mm), np.diff(self.x_mm)))
        return float(areas[~self.closed].sum() / areas.sum())


def printable_cells(mask: Mask, extent_mm: float, line_mm: float) -> Cells:
    """Closed cells of a mask that is printed in one piece.

    Where openings touch at a corner, and closed parts with them, a bridge of two lines is left.
    Raises `InputError` if a closed part hangs on nothing.
    """
    closed = _printed_cells(mask, extent_mm, line_mm)
    cell_mm = extent_mm / max(closed.shape)
    if _touching(closed).any():
        cells = _bridged(closed, cell_mm, line_mm)
    else:
        rows, columns = closed.shape
        cells = Cells(closed, _edges(columns, cell_mm), -_edges(rows, cell_mm))
    framed = np.pad(cells.closed, 1, constant_values=True).astype(np.uint8)
    loose = cv2.connectedComponents(framed, connectivity=4)[0] - 2
    if loose:
        parts = "one closed part hangs" if loose == 1 else f"{loose} closed parts hang"
        raise InputError(
            f"a mask printed in one piece: {parts} on nothing: print the holder alone, for a mask "
            "on film, or leave bars in the mask"
        )
    return cells


def _edges(count: int, cell_mm: float) -> DoubleArray:
    return np.asarray((np.arange(count + 1) - count / 2) * cell_mm, np.float64)


def _printed_cells(mask: Mask, extent_mm: float, line_mm: float) -> BoolArray:
    """Closed cells [n, m], no finer than a printer can make use of."""
    cells = cells_to_cut(mask)
    if extent_mm / max(cells.shape) < line_mm / _FINENESS:
        count = math.ceil(extent_mm * _FINENESS / line_mm)
        size = [max(1, round(count * side / max(cells.shape))) for side in cells.shape]
        share = cv2.resize(cells.astype(np.float32), size[::-1], interpolation=cv2.INTER_AREA)
        cells = np.asarray(share > 0.5)
    return ~cells


def _touching(closed: BoolArray) -> BoolArray:
    """Inner corners [n - 1, m - 1] where two closed cells meet two open ones crosswise."""
    first, second = closed[:-1, :-1], closed[:-1, 1:]
    third, fourth = closed[1:, :-1], closed[1:, 1:]
    return np.asarray((first == fourth) & (second == third) & (first != second))


def _bridged(closed: BoolArray, cell_mm: float, line_mm: float) -> Cells:
    """Cells with a closed square around each corner where openings touch."""
    # The bridge is as wide as the diagonal of the square.
    half_mm = line_mm * _LINES / math.sqrt(2) / 2
    corners = np.argwhere(_touching(closed)) + 1
    if 2 * half_mm < cell_mm:
        # Cells in three parts, the outer ones as wide as half of the square.
        parts, reach = 3, 1
        steps_mm = np.array([0.0, half_mm, cell_mm - half_mm])
    else:
        parts, reach = 1, math.ceil(half_mm / cell_mm)
        steps_mm = np.zeros(1)
    fine = np.kron(closed, np.ones((parts, parts), bool))
    for row, column in corners * parts:
        here = [slice(max(at - reach, 0), at + reach) for at in (row, column)]
        fine[tuple(here)] = True
    x_mm, y_mm = (
        np.append((edges[:-1, None] + steps_mm).ravel(), edges[-1])
        for edges in (_edges(count, cell_mm) for count in closed.shape[::-1])
    )
    return Cells(fine, x_mm, -y_mm)


def _grid_plan(cells: Cells, floor_mm: float) -> tuple[Plan, IndexArray]:
    """Floor with openings, and the indices of the corners around its grid, anticlockwise."""
    points = np.stack(np.meshgrid(cells.x_mm, cells.y_mm), axis=-1).reshape(-1, 2)
    index = np.arange(len(points)).reshape(len(cells.y_mm), len(cells.x_mm))
    upper_left, upper_right = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    lower_left, lower_right = index[1:, :-1].ravel(), index[1:, 1:].ravel()
    triangles = np.concatenate(
        [
            np.stack([lower_left, lower_right, upper_right], axis=1),
            np.stack([lower_left, upper_right, upper_left], axis=1),
        ]
    )
    heights = np.tile(np.where(cells.closed.ravel(), floor_mm, 0.0), 2)
    around = [index[-1, :-1], index[:0:-1, -1], index[0, :0:-1], index[:-1, 0]]
    return Plan(points, triangles, heights), np.concatenate(around)


def _with_ring(
    plan: Plan, inner: IndexArray, outer: DoubleArray, height_mm: float
) -> tuple[Plan, IndexArray]:
    """Plan with a ring around it, and the indices of the ring's outer corners."""
    count = len(plan.points)
    corners = np.append(inner, count + np.arange(len(outer)))
    ring = corners[triangles_between(plan.points[inner], outer)]
    return (
        Plan(
            np.concatenate([plan.points, outer]),
            np.concatenate([plan.triangles, ring]),
            np.append(plan.heights, np.full(len(ring), height_mm)),
        ),
        corners[len(inner) :],
    )
