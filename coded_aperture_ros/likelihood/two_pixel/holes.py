"""The equal openings of a mask, found from its pattern."""

import dataclasses

import numpy as np
import scipy.ndimage

from coded_aperture_ros.core.arrays import DoubleArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Mask

# The work grows as N (N - 1); beyond this many openings the filter bank is both faster and better.
_MOST_HOLES = 8
# Two openings are equal if what they do not share is less than this share of their area: the edges
# of a photographed or drawn mask differ by parts of a cell.
_DIFFERENCE = 0.15
# Pairs of holes whose lines part by less than this, in px, at their far ends share a line.
_ONE_LINE_PX = 0.5
_USE_BANK = "use --method bank, which takes any mask"


@dataclasses.dataclass(frozen=True, eq=False)
class Holes:
    """Equal openings of a mask."""

    # [N, 2]; row and column of every opening's centre from the middle of the mask, in units of the
    # mask's extent (``Delta_i`` of thesis eq. 5.1).
    centres: DoubleArray
    side: float  # side of an opening's bounding square, in the same units

    @property
    def count(self) -> int:
        """Number N of openings."""
        return len(self.centres)

    @property
    def offsets(self) -> DoubleArray:
        """``delta_ij = Delta_i - Delta_j`` of all ordered pairs [N (N - 1), 2] (eq. 5.18, 5.19)."""
        first, second = np.nonzero(~np.eye(self.count, dtype=bool))
        return self.centres[first] - self.centres[second]


def find_holes(mask: Mask) -> Holes:
    """Find the equal openings of a mask.

    Openings are the connected parts of what lets light through; those that only touch at a corner
    are two. Raises `InputError`, naming the mask and the reason: one opening only, more than eight,
    or openings of unequal area or shape.
    """
    cells = mask.transmission.astype(np.float64)
    labels, count = scipy.ndimage.label(cells > 0)
    where = f"mask {mask.name}"
    if count < 2:
        raise InputError(
            f"{where}: it has one opening, and the two-pixel method compares what several "
            f"equal ones show: {_USE_BANK}"
        )
    if count > _MOST_HOLES:
        raise InputError(
            f"{where}: it has {count} openings, and the two-pixel method takes at most "
            f"{_MOST_HOLES}, as its work grows as the square of their number: {_USE_BANK}"
        )
    numbers = np.arange(1, count + 1)
    areas = scipy.ndimage.sum_labels(cells, labels, numbers)
    boxes = scipy.ndimage.find_objects(labels)
    size = tuple(max(box[axis].stop - box[axis].start for box in boxes) for axis in (0, 1))
    shapes = np.zeros((count, *size))
    for shape, number, (rows, columns) in zip(shapes, numbers, boxes, strict=True):
        # Only the opening itself: another one may reach into its bounding box.
        own = np.where(labels[rows, columns] == number, cells[rows, columns], 0)
        shape[: own.shape[0], : own.shape[1]] = own
    difference = np.abs(shapes - shapes[0]).sum(axis=(1, 2)) / areas.max()
    worst = int(difference.argmax())
    if difference[worst] > _DIFFERENCE:
        raise InputError(
            f"{where}: its {count} openings are not equal, opening {worst + 1} and the first "
            f"differ by {100 * difference[worst]:.0f} % of their area, where the two-pixel "
            f"method needs openings of one shape and size: {_USE_BANK}"
        )
    extent = max(cells.shape)
    middle = (np.array(cells.shape) - 1) / 2
    centres = np.array(scipy.ndimage.center_of_mass(cells, labels, numbers))
    return Holes((centres - middle) / extent, max(size) / extent)


@dataclasses.dataclass(frozen=True, eq=False)
class NeighbourLine:
    """The pixels on a digital line: the neighbours ``p + d delta_ij`` of all levels ``d``.

    The disparity of a level need not be whole: the covariances at the whole lags around it, which
    are exact, say where between two of them it is.
    """

    direction: DoubleArray  # [2]; row and column, the longer of them 1
    # [n, 2]; row and column of the pixels, from the first one, a pixel apart along the longer axis.
    positions: IndexArray
    lags: IndexArray  # [m, 2]; the different lags between two of them; rows >= 0. At most 2 n - 1.
    lag_of_pair: IndexArray  # [n, n]; index of every pair's lag

    @classmethod
    def along(cls, direction: DoubleArray, length_px: int) -> "NeighbourLine":
        """Draw the line from a pixel in a direction (row, column) that `length_px` is far along."""
        steps = np.arange(length_px + 1)[:, None]
        direction = direction / np.abs(direction).max()
        positions = np.rint(steps * direction).astype(np.intp)
        between = positions[:, None] - positions[None, :]
        # A covariance is the same both ways.
        backward = (between[..., 0] < 0) | ((between[..., 0] == 0) & (between[..., 1] < 0))
        between[backward] *= -1
        lags, index = np.unique(between.reshape(-1, 2), axis=0, return_inverse=True)
        return cls(direction, positions, lags, index.reshape(len(positions), len(positions)))


def neighbour_lines(holes: Holes, largest_blur_px: float) -> list[NeighbourLine]:
    """Return the lines on which the neighbours of all levels lie (thesis eq. 5.18).

    N holes in general position have N (N - 1) / 2; parallel pairs share one. Where some directions
    are shared by more pairs than others, there are two or more of these, and every hole is part of
    one, the others are left out: they tell the same over again, but fainter. The diagonals of four
    holes in a square double the work, and the error on natural texture (noise 0.001, window 96 px)
    grows from 0.63 to 1.33 levels with them. Each is as long as the largest disparity along it, at
    the `largest_blur_px` of the whole mask, and half the blur of a hole.
    """
    first, second = np.triu_indices(holes.count, 1)
    offsets = (holes.centres[first] - holes.centres[second]) * abs(largest_blur_px)
    lengths = np.abs(offsets).max(axis=1)
    found: list[tuple[DoubleArray, float]] = []
    pairs: list[list[int]] = []
    for place in np.argsort(-lengths, kind="stable"):
        direction, length = offsets[place] / lengths[place], lengths[place]
        apart = [_apart(direction, other) * length for other, _ in found]
        if apart and min(apart) <= _ONE_LINE_PX:
            pairs[int(np.argmin(apart))].append(int(place))
        else:
            found.append((direction, length))
            pairs.append([int(place)])
    most = max(map(len, pairs))
    shared = [number for number, of_line in enumerate(pairs) if len(of_line) == most]
    part_of = {int(hole) for n in shared for p in pairs[n] for hole in (first[p], second[p])}
    if len(shared) < 2 or len(part_of) < holes.count:
        shared = list(range(len(found)))
    hole_px = holes.side * abs(largest_blur_px)
    return [
        NeighbourLine.along(direction, int(np.ceil(length + hole_px / 2)))
        for direction, length in (found[n] for n in shared)
    ]


def _apart(one: DoubleArray, other: DoubleArray) -> float:
    """Return how far two directions of unit reach part, per pixel along them; signless."""
    return float(min(np.abs(one - other).max(), np.abs(one + other).max()))
