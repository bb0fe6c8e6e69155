"""Where the neighbours of a pixel lie: on lines through it, one for each direction of the holes."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, IndexArray
from coded_aperture_ros.likelihood.two_pixel.holes import Holes

# Pairs of holes whose lines part by less than this, in px, at their far ends share a line.
_ONE_LINE_PX = 0.5


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
