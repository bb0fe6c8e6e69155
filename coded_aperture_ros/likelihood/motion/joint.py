"""Choosing motion and depth together: what one knows of the other, and of its neighbours."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.likelihood.motion.config import MotionConfig
from coded_aperture_ros.likelihood.motion.kernels import Motions
from coded_aperture_ros.likelihood.motion.occurring import occurring_motions, refined_motion

# The cost of a motion counts up to here; beyond, it is an outlier (natural logarithm).
_MOST_COST = 14.0
_MOST_TO_REFINE = 27.0
# How much more a motion costs that does not occur, where it counts for depth.
_OTHERS = 4.0
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
    known = np.minimum(known - known.min(axis=0), np.float32(_MOST_COST))
    apart_px = motions.distances_px(motions.vectors_px)
    neighbours = np.argsort(apart_px, axis=1)[:, 1 : _NEIGHBOURS + 1]  # the nearest is itself
    total = _semi_global(known, _within(neighbours, some), config.motion_smoothness)
    motion = some[total.argmin(axis=0)]
    vectors = motions.vectors_px.copy()
    for index in some[~static[some]]:
        here = motion == index
        if here.any():
            of_all = np.minimum(of_motion[:, here], np.float32(_MOST_TO_REFINE)).sum(axis=1)
            vectors[index] = refined_motion(of_all, motions, int(index))
    others = total - known + handicap
    others -= others.min(axis=0)
    # Others count as well, at a price: a smooth patch may look like none of those that occur.
    against = np.broadcast_to(others.min(axis=0) + np.float32(_OTHERS), probability.shape).copy()
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
