"""The equal openings of a mask, found from its pattern."""

import dataclasses

import numpy as np
import scipy.ndimage

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Mask

# The work grows as N (N - 1); beyond this many openings the filter bank is both faster and better.
_MOST_HOLES = 8
# Two openings are equal if what they do not share is less than this share of their area: the edges
# of a photographed or drawn mask differ by parts of a cell.
_DIFFERENCE = 0.15
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
