"""Choosing motion and depth together: what one knows of the other, and of its neighbours."""

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
    """What a frame says about motion, and about depth whatever the motion.

    `motion` is the index of every patch's motion [rows, columns], `candidates` are the motions that
    were tried [k, rows, columns], and `probability` that of each of them, by the patch alone.
    `level_cost` is that of every blur level [rows, columns, L], motions weighed by how likely they
    are beside the neighbours'; `vectors_px` [M, 2] what the motions exactly are, where they occur.
    """

    motion: IndexArray
    candidates: IndexArray
    probability: FloatArray
    level_cost: FloatArray
    vectors_px: DoubleArray


def separate(cost: FloatArray, motions: Motions, config: MotionConfig, overlap: float) -> Separated:
    """Choose the motions of all patches together, and take them out of the cost of levels.

    Thesis eq. 7.4 has total variation of depth and of motion beside the data. Here the few motions
    that occur are found first, whatever the depth; each patch gets one of them, semi-globally; and
    then the depth follows under what has become of the motions: not only the chosen one counts,
    but each as far as its neighbours allow for it.

    Takes the cost of every pair of motion and level [M, L, rows, columns], 0 for the likeliest, and
    the `overlap`: width of the patches over the distance between them.
    """
    likelihood = np.exp(-cost)
    probability = likelihood.sum(axis=1)
    probability /= probability.sum(axis=0)
    of_motion = -np.log(np.maximum(probability, np.float32(1e-30)))
    of_motion -= of_motion.min(axis=0)
    some = occurring_motions(of_motion, motions, overlap)
    static = np.hypot(*motions.vectors_px.T) == 0
    handicap = np.where(static, 0, config.motion_threshold).astype(np.float32)[some, None, None]
    known = of_motion[some] + handicap
    known = np.minimum(known - known.min(axis=0), np.float32(_MAX_CHOICE_COST))
    apart_px = motions.distances_px(motions.vectors_px)
    neighbours = np.argsort(apart_px, axis=1)[:, 1 : _NEIGHBOURS + 1]  # the nearest is itself
    total = _semi_global(known, _within(neighbours, some), config.motion_smoothness)
    motion = some[total.argmin(axis=0)]
    vectors = motions.vectors_px.copy()
    for index in some[~static[some]]:
        here = motion == index
        if here.any():
            of_all = np.minimum(of_motion[:, here], np.float32(_MAX_OCCURRING_COST)).sum(axis=1)
            vectors[index] = refined_motion(of_all, motions, int(index))
    others = total - known + handicap
    others -= others.min(axis=0)
    # Others count as well, at a price: a smooth patch may look like none of those that occur.
    against = np.broadcast_to(
        others.min(axis=0) + np.float32(_NOT_OCCURRING_COST), probability.shape
    ).copy()
    for index, price in zip(some, others, strict=True):
        # What moves may do so a little differently.
        near = [index] if static[index] else [index, *neighbours[index]]
        against[near] = np.minimum(against[near], price)
    weighed = np.einsum("mlrc,mrc->lrc", likelihood, np.exp(-against))
    level = -np.log(np.maximum(weighed, np.float32(1e-30)))
    level -= level.min(axis=0)
    every = np.arange(len(motions))[:, None, None]
    candidates = np.broadcast_to(every, probability.shape)
    return Separated(motion, candidates, probability, np.moveaxis(level, 0, -1), vectors)


def separate_expected(cost: FloatArray, candidates: IndexArray, motions: Motions) -> Separated:
    """Choose among a few motions that were expected; neighbours are as good already.

    Takes the cost of every pair of candidate and level [k, L, rows, columns], and which motions the
    candidates are [rows, columns, k].
    """
    likelihood = np.exp(-cost)
    probability = likelihood.sum(axis=1)
    probability /= probability.sum(axis=0)
    level = -np.log(np.maximum(likelihood.sum(axis=0), np.float32(1e-30)))
    level -= level.min(axis=0)
    tried = np.moveaxis(candidates, -1, 0)
    motion = np.take_along_axis(tried, probability.argmax(axis=0)[None], axis=0)[0]
    level = np.moveaxis(level, 0, -1)
    return Separated(motion, tried, probability, level, motions.vectors_px)


def _within(neighbours: IndexArray, some: IndexArray) -> IndexArray:
    """Return which of some motions are neighbours [m, n], as numbers of these; else its own."""
    number = np.full(len(neighbours), -1)
    number[some] = np.arange(len(some))
    of_some = number[neighbours[some]]
    return np.where(of_some < 0, np.arange(len(some))[:, None], of_some)


def _semi_global(known: FloatArray, neighbours: IndexArray, smoothness: float) -> FloatArray:
    """Minimise along rows and columns, both ways, and add up, as `depth` does with levels.

    Takes and gives [m, rows, columns].
    """
    of_rows = np.moveaxis(known, 0, 1)  # [rows, M, columns]
    of_columns = np.moveaxis(known, (2, 1), (0, 2))  # [columns, M, rows]
    down = _both_ways(of_rows, neighbours, smoothness)
    across = _both_ways(of_columns, neighbours, smoothness)
    total = np.moveaxis(down, 1, 0) + np.moveaxis(across, (0, 2), (2, 1))
    return total - 3 * known  # every path counts the cost of its patch


def _both_ways(cost: FloatArray, neighbours: IndexArray, smoothness: float) -> FloatArray:
    """Add up the costs of the best paths that reach each patch along the first axis."""
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


def occurring_motions(of_motion: FloatArray, motions: Motions, overlap: float) -> IndexArray:
    """Choose the few motions that explain all patches, thesis eq. 7.4 with a price for each motion.

    One after the other those are added that the patches gain most by, windows' neighbourhoods
    taken together, until no motion is worth it.

    Takes the cost of every motion whatever the depth [M, rows, columns], and the `overlap`:
    windows' width over the distance between them. Returns indices [m], first no motion, if it is
    one of them.
    """
    around = max(round(overlap) // 2 * 2 - 1, 1)
    capped = np.minimum(of_motion, np.float32(_MAX_OCCURRING_COST))
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
