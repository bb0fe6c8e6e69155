"""Which motions occur in a frame at all, and which way exactly."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.likelihood.motion.kernels import Motions

# The cost of a motion counts up to here (natural logarithm); beyond, its model is wrong.
_MOST_COST = 27.0
# Texture with a direction of its own makes a wrong motion cheaper by about so much.
_OF_TEXTURE = 5.0
# What patches that do not overlap must gain together beyond that: false ones had 21 at most, true
# ones from 150.
_ENOUGH = 40.0
# A frame is divided among so many motions at most.
_MOST_MOTIONS = 12


def occurring_motions(of_motion: FloatArray, motions: Motions, overlap: float) -> IndexArray:
    """Choose the few motions that explain all patches, thesis eq. 7.4 with a price for each motion.

    One after the other those are added that the patches gain most by, windows' neighbourhoods
    taken together, until no motion is worth it.

    Takes the cost of every motion whatever the depth [M, rows, columns], and the `overlap`:
    windows' width over the distance between them. Returns indices [m], first no motion, if it is
    one of them.
    """
    around = max(round(overlap) // 2 * 2 - 1, 1)
    capped = np.minimum(of_motion, np.float32(_MOST_COST))
    shape = (around, around)
    together = np.array([cv2.blur(each, shape, borderType=cv2.BORDER_REPLICATE) for each in capped])
    independent = max(overlap / 2, 1) ** 2
    static = np.flatnonzero(np.hypot(*motions.vectors_px.T) == 0)
    chosen = [int(static[0]) if static.size else int(together.sum(axis=(1, 2)).argmin())]
    least = together[chosen[0]]
    while len(chosen) < min(_MOST_MOTIONS, len(motions)):
        gains = np.maximum(least - together - np.float32(_OF_TEXTURE), 0).sum(axis=(1, 2))
        best = int(gains.argmax())
        if gains[best] < _ENOUGH * independent:
            break
        chosen.append(best)
        least = np.minimum(least, together[best])
    return np.array(chosen)


def refined_motion(total: NDArray[np.floating], motions: Motions, index: int) -> DoubleArray:
    """Refine a motion by parabolas along its length and across its direction; returns [2].

    By the cost of every motion [M], in `total` of all patches that have this one, which has a
    length.
    """
    right, down = motions.vectors_px.T
    lengths, angles = np.hypot(right, down), np.arctan2(down, right)
    length, angle = lengths[index], angles[index]
    # Opposite motions are one: directions differ within half a turn.
    turns = (angles - angle + np.pi / 2) % np.pi - np.pi / 2
    parallel = (np.abs(turns) < 1e-6) | (lengths == 0)
    length += _vertex(lengths - length, total, parallel)
    angle += _vertex(turns, total, np.abs(lengths - lengths[index]) < 1e-6)
    return np.asarray(length * np.array([np.cos(angle), np.sin(angle)]))


def _vertex(offsets: DoubleArray, total: NDArray[np.floating], usable: BoolArray) -> float:
    """Return where a parabola through 0 and the next offsets on both sides is least."""
    here = float(total[usable & (np.abs(offsets) < 1e-6)].min())
    sides = []
    for sign in (-1, 1):
        there = np.flatnonzero(usable & (sign * offsets > 1e-6))
        if not there.size:
            return 0.0
        nearest = there[np.argmin(sign * offsets[there])]
        sides.append((float(offsets[nearest]), float(total[nearest]) - here))
    (left, at_left), (right, at_right) = sides
    curvature = (at_right / right - at_left / left) / (right - left)
    if curvature <= 0:
        return 0.0
    slope = at_right / right - curvature * right
    return float(np.clip(-slope / (2 * curvature), left / 2, right / 2))
