"""Joint estimate of motion and depth, with neighbouring patches (thesis eq. 7.4)."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.likelihood.motion.config import MotionConfig
from coded_aperture_ros.likelihood.motion.kernels import Motions

# Cost of a motion (natural logarithm) is limited to this in the search for those that occur:
# beyond, its model is wrong.
_MAX_OCCURRING_COST = 27.0
# Texture with a direction of its own makes a wrong motion cheaper by about so much.
_TEXTURE_GAIN = 5.0
# What patches that do not overlap must gain together beyond that: false ones had 21 at most, true
# ones from 150.
_MIN_TOTAL_GAIN = 40.0
# A frame is divided among so many motions at most.
_MAX_MOTIONS = 12
# Cost of a motion is limited to this where patches choose among those that occur; beyond, it is an
# outlier.
_MAX_CHOICE_COST = 14.0
# How much more a motion costs that does not occur, where it counts for depth.
_NOT_OCCURRING_COST = 4.0
# Motions that are neighbours of each, between which a patch and the next change easily.
_NEIGHBOURS = 6
# Weights of the smoothness beside natural-logarithm likelihoods.
_P1 = 6.0
_P2 = 24.0


@dataclasses.dataclass(frozen=True, eq=False)
class Separated:
    """Motion of every patch, and the cost of every level, marginalised over motion."""

    motion: IndexArray  # [rows, columns]; index of every patch's motion
    candidates: IndexArray  # [k, rows, columns]; indices of the motions that were compared
    probability: FloatArray  # [k, rows, columns]; of each candidate, by the patch alone
    level_cost: FloatArray  # [rows, columns, L]; motions weighted by those of the neighbours
    vectors_px: DoubleArray  # [M, 2]; motions, px, refined if they occur


def separate(cost: FloatArray, motions: Motions, config: MotionConfig, overlap: float) -> Separated:
    """Motions of all patches together, and the cost of levels marginalised over motion.

    Thesis eq. 7.4 has total variation of depth and of motion beside the data. Here the few motions
    that occur are found first, independent of depth; each patch gets one of them by semi-global
    matching; then the cost of a level is that of all motions, each weighted by the motions of the
    neighbouring patches.

    Parameters
    ----------
    cost : ndarray, float32 [M, L, rows, columns]
        Cost of every pair of motion and level, 0 for the likeliest.
    motions : Motions
    config : MotionConfig
    overlap : float
        Side of the patches over the distance between them.
    """
    likelihood = np.exp(-cost)
    probability = likelihood.sum(axis=1)
    probability /= probability.sum(axis=0)
    motion_cost = -np.log(np.maximum(probability, np.float32(1e-30)))
    motion_cost -= motion_cost.min(axis=0)
    occurring = occurring_motions(motion_cost, motions, overlap)
    static = np.hypot(*motions.vectors_px.T) == 0
    handicap = np.where(static, 0, config.motion_threshold).astype(np.float32)[
        occurring, None, None
    ]
    choice_cost = motion_cost[occurring] + handicap
    choice_cost = np.minimum(choice_cost - choice_cost.min(axis=0), np.float32(_MAX_CHOICE_COST))
    apart_px = motions.distances_px(motions.vectors_px)
    neighbours = np.argsort(apart_px, axis=1)[:, 1 : _NEIGHBOURS + 1]  # the nearest is itself
    total = _semi_global(
        choice_cost, _occurring_neighbours(neighbours, occurring), config.motion_smoothness
    )
    motion = occurring[total.argmin(axis=0)]
    vectors = motions.vectors_px.copy()
    for index in occurring[~static[occurring]]:
        here = motion == index
        if here.any():
            summed = np.minimum(motion_cost[:, here], np.float32(_MAX_OCCURRING_COST)).sum(axis=1)
            vectors[index] = refine_motion(summed, motions, int(index))
    prices = total - choice_cost + handicap
    prices -= prices.min(axis=0)
    # Motions that do not occur count as well: a smooth patch may look like none of the others.
    against = np.broadcast_to(
        prices.min(axis=0) + np.float32(_NOT_OCCURRING_COST), probability.shape
    ).copy()
    for index, price in zip(occurring, prices, strict=True):
        # Neighbouring patches may move a little differently.
        near = [index] if static[index] else [index, *neighbours[index]]
        against[near] = np.minimum(against[near], price)
    weighted = np.einsum("mlrc,mrc->lrc", likelihood, np.exp(-against))
    level = -np.log(np.maximum(weighted, np.float32(1e-30)))
    level -= level.min(axis=0)
    every = np.arange(len(motions))[:, None, None]
    candidates = np.broadcast_to(every, probability.shape)
    return Separated(motion, candidates, probability, np.moveaxis(level, 0, -1), vectors)


def separate_expected(cost: FloatArray, candidates: IndexArray, motions: Motions) -> Separated:
    """Motions of all patches among expected ones, each by itself, and the cost of levels.

    Parameters
    ----------
    cost : ndarray, float32 [k, L, rows, columns]
        Cost of every pair of candidate and level, 0 for the likeliest.
    candidates : ndarray, int [rows, columns, k]
        Indices of the candidates among the `motions`.
    motions : Motions
    """
    likelihood = np.exp(-cost)
    probability = likelihood.sum(axis=1)
    probability /= probability.sum(axis=0)
    level = -np.log(np.maximum(likelihood.sum(axis=0), np.float32(1e-30)))
    level -= level.min(axis=0)
    by_candidate = np.moveaxis(candidates, -1, 0)
    motion = np.take_along_axis(by_candidate, probability.argmax(axis=0)[None], axis=0)[0]
    level = np.moveaxis(level, 0, -1)
    return Separated(motion, by_candidate, probability, level, motions.vectors_px)


def _occurring_neighbours(neighbours: IndexArray, occurring: IndexArray) -> IndexArray:
    """Neighbours [m, n] of the m motions that occur, as their numbers; its own if it does not."""
    number = np.full(len(neighbours), -1)
    number[occurring] = np.arange(len(occurring))
    found = number[neighbours[occurring]]
    return np.where(found < 0, np.arange(len(occurring))[:, None], found)


def _semi_global(cost: FloatArray, neighbours: IndexArray, smoothness: float) -> FloatArray:
    """Costs [m, rows, columns] of the best paths along rows and columns, both ways, added up."""
    by_row = np.moveaxis(cost, 0, 1)  # [rows, m, columns]
    by_column = np.moveaxis(cost, (2, 1), (0, 2))  # [columns, m, rows]
    down = _path_costs(by_row, neighbours, smoothness)
    across = _path_costs(by_column, neighbours, smoothness)
    total = np.moveaxis(down, 1, 0) + np.moveaxis(across, (0, 2), (2, 1))
    return total - 3 * cost  # every path counts the cost of its patch


def _path_costs(cost: FloatArray, neighbours: IndexArray, smoothness: float) -> FloatArray:
    """Costs of the best paths that reach each patch along the first axis, both ways, added up."""
    p1, p2 = np.float32(_P1 * smoothness), np.float32(_P2 * smoothness)
    costs = np.stack([cost, cost[::-1]], axis=1)  # [n, 2, M, m]
    for i in range(1, len(costs)):
        previous = costs[i - 1] - costs[i - 1].min(axis=1, keepdims=True)
        best = np.minimum(previous, p2)
        if neighbours.shape[1]:
            near = previous[:, neighbours[:, 0]]
            for column in neighbours.T[1:]:
                near = np.minimum(near, previous[:, column])
            best = np.minimum(best, near + p1)
        costs[i] += best
    return np.asarray(costs[:, 0] + costs[::-1, 1])


def occurring_motions(cost: FloatArray, motions: Motions, overlap: float) -> IndexArray:
    """Indices of the few motions that explain all patches [m], first no motion if it is known.

    This is thesis eq. 7.4 with a price for each motion: the motion that lowers the cost of the
    patches most, averaged over neighbourhoods, is added until none lowers it enough.

    Parameters
    ----------
    cost : ndarray, float32 [M, rows, columns]
        Cost of every motion, independent of depth.
    motions : Motions
    overlap : float
        Side of the patches over the distance between them.
    """
    around = max(round(overlap) // 2 * 2 - 1, 1)
    capped = np.minimum(cost, np.float32(_MAX_OCCURRING_COST))
    shape = (around, around)
    together = np.array([cv2.blur(each, shape, borderType=cv2.BORDER_REPLICATE) for each in capped])
    independent = max(overlap / 2, 1) ** 2
    static = np.flatnonzero(np.hypot(*motions.vectors_px.T) == 0)
    chosen = [int(static[0]) if static.size else int(together.sum(axis=(1, 2)).argmin())]
    least = together[chosen[0]]
    while len(chosen) < min(_MAX_MOTIONS, len(motions)):
        gains = np.maximum(least - together - np.float32(_TEXTURE_GAIN), 0).sum(axis=(1, 2))
        best = int(gains.argmax())
        if gains[best] < _MIN_TOTAL_GAIN * independent:
            break
        chosen.append(best)
        least = np.minimum(least, together[best])
    return np.array(chosen)


def refine_motion(total: NDArray[np.floating], motions: Motions, index: int) -> DoubleArray:
    """Motion, px [2], at the minima of parabolas along its length and across its direction.

    Parameters
    ----------
    total : ndarray [M]
        Cost of every motion, summed over the patches with this one.
    motions : Motions
    index : int
        Which of the motions; it must have a length.
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
    """Offset of the minimum of a parabola through 0 and the next offsets on both sides."""
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
