"""Equal openings of a mask, and the lines on which the neighbours of a pixel lie."""

import dataclasses

import numpy as np
import scipy.ndimage

from coded_aperture_ros.core.arrays import DoubleArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Mask

# The work grows as N (N - 1); beyond this many openings the filter bank is both faster and better.
_MAX_HOLES = 8
# Openings are equal if they differ by less than this share of their area: the edges of a
# photographed or drawn mask differ by parts of a cell.
_MAX_DIFFERENCE = 0.15
# Pairs of holes share a line if their lines are less than this apart at the far ends, px.
_SAME_LINE_PX = 0.5
_USE_BANK = "use --method bank, which takes any mask"


@dataclasses.dataclass(frozen=True, eq=False)
class Holes:
    """Equal openings of a mask.

    References
    ----------
    Martinello 2012, eq. 5.1, 5.18 and 5.19.
    """

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
    """Equal openings of a mask: its connected transparent parts, which may touch at corners.

    Parameters
    ----------
    mask : Mask

    Returns
    -------
    Holes

    Raises
    ------
    InputError
        Naming the mask and the reason: one opening only, more than eight, or openings of unequal
        area or shape.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> find_holes(Mask.named("four_hole")).count
    4
    """
    cells = mask.transmission.astype(np.float64)
    labels, count = scipy.ndimage.label(cells > 0)
    name = f"mask {mask.name}"
    if count < 2:
        raise InputError(
            f"{name}: it has one opening, and the two-pixel method compares what several "
            f"equal ones show: {_USE_BANK}"
        )
    if count > _MAX_HOLES:
        raise InputError(
            f"{name}: it has {count} openings, and the two-pixel method takes at most "
            f"{_MAX_HOLES}, as its work grows as the square of their number: {_USE_BANK}"
        )
    numbers = np.arange(1, count + 1)
    areas = scipy.ndimage.sum_labels(cells, labels, numbers)
    boxes = scipy.ndimage.find_objects(labels)
    size = tuple(max(box[axis].stop - box[axis].start for box in boxes) for axis in (0, 1))
    shapes = np.zeros((count, *size))
    for shape, number, (rows, columns) in zip(shapes, numbers, boxes, strict=True):
        # Another opening may reach into the bounding box.
        opening = np.where(labels[rows, columns] == number, cells[rows, columns], 0)
        shape[: opening.shape[0], : opening.shape[1]] = opening
    difference = np.abs(shapes - shapes[0]).sum(axis=(1, 2)) / areas.max()
    worst = int(difference.argmax())
    if difference[worst] > _MAX_DIFFERENCE:
        raise InputError(
            f"{name}: its {count} openings are not equal, opening {worst + 1} and the first "
            f"differ by {100 * difference[worst]:.0f} % of their area, where the two-pixel "
            f"method needs openings of one shape and size: {_USE_BANK}"
        )
    extent = max(cells.shape)
    middle = (np.array(cells.shape) - 1) / 2
    centres = np.array(scipy.ndimage.center_of_mass(cells, labels, numbers))
    return Holes((centres - middle) / extent, max(size) / extent)


@dataclasses.dataclass(frozen=True, eq=False)
class NeighbourLine:
    """Pixels on a digital line: the neighbours ``p + d delta_ij`` of all levels ``d``.

    A disparity need not be a whole number: the covariances at the whole lags around it are exact.
    """

    direction: DoubleArray  # [2]; row and column, the longer of them 1
    # [n, 2]; row and column of the pixels from the first one, a pixel apart along the longer axis.
    positions: IndexArray
    lags: IndexArray  # [m, 2]; different lags between two pixels, rows >= 0; at most 2 n - 1
    pair_lags: IndexArray  # [n, n]; index of every pair's lag

    @classmethod
    def along(cls, direction: DoubleArray, length_px: int) -> "NeighbourLine":
        """Line of a length along the longer axis, px, in a direction (row, column)."""
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
    """Lines on which the neighbours of all levels lie.

    N holes in general position have N (N - 1) / 2 lines; parallel pairs share one. If two or more
    directions are shared by more pairs than the others, and every hole is part of one, the others
    are left out, as they are redundant: the diagonals of four holes in a square double the work,
    and the error on natural texture (noise 0.001, window 96 px) grows from 0.63 to 1.33 levels with
    them. A line is as long as the largest disparity along it and half the blur of a hole.

    Parameters
    ----------
    holes : Holes
    largest_blur_px : float
        Largest blur size of the whole mask, px.

    References
    ----------
    Martinello 2012, eq. 5.18.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask
    >>> [len(line.positions) for line in neighbour_lines(find_holes(Mask.named("two_hole")), 12.0)]
    [12]
    """
    first, second = np.triu_indices(holes.count, 1)
    offsets = (holes.centres[first] - holes.centres[second]) * abs(largest_blur_px)
    lengths = np.abs(offsets).max(axis=1)
    found: list[tuple[DoubleArray, float]] = []
    pairs: list[list[int]] = []
    for pair in np.argsort(-lengths, kind="stable"):
        direction, length = offsets[pair] / lengths[pair], lengths[pair]
        separations = [_separation(direction, other) * length for other, _ in found]
        if separations and min(separations) <= _SAME_LINE_PX:
            pairs[int(np.argmin(separations))].append(int(pair))
        else:
            found.append((direction, length))
            pairs.append([int(pair)])
    most = max(map(len, pairs))
    shared = [number for number, on_line in enumerate(pairs) if len(on_line) == most]
    covered = {int(hole) for n in shared for p in pairs[n] for hole in (first[p], second[p])}
    if len(shared) < 2 or len(covered) < holes.count:
        shared = list(range(len(found)))
    hole_px = holes.side * abs(largest_blur_px)
    return [
        NeighbourLine.along(direction, int(np.ceil(length + hole_px / 2)))
        for direction, length in (found[n] for n in shared)
    ]


def _separation(one: DoubleArray, other: DoubleArray) -> float:
    """Distance of two lines per pixel along them, whatever the sign of their directions."""
    return float(min(np.abs(one - other).max(), np.abs(one + other).max()))
