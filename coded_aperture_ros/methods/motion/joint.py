"""Choosing motion and depth together: what one knows of the other, and of its neighbours."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.methods.motion.config import MotionConfig
from coded_aperture_ros.methods.motion.kernels import Motions
from coded_aperture_ros.methods.motion.occurring import occurring_motions, refined_motion

# Evidence against a motion counts up to here; beyond, it is an outlier (natural logarithm).
_ENOUGH_EVIDENCE = 14.0
_ENOUGH_TO_REFINE = 27.0
# Evidence that a motion which does not occur must have more, to count for depth.
_OTHERS = 4.0
# Motions that are neighbours of each, between which a patch and the next change easily.
_NEIGHBOURS = 6
# Weights of the smoothness beside natural-logarithm evidence.
_SLIGHT_STEP = 6.0
_JUMP = 24.0


@dataclasses.dataclass(frozen=True, eq=False)
class Separated:
    """What a frame says about motion, and about depth whatever the motion.

    Attributes
    ----------
    motion : ndarray of int [rows, columns]
        Index of every patch's motion.
    candidates : ndarray of int [k, rows, columns]
        The motions that were tried.
    probability : ndarray, float32 [k, rows, columns]
        Of each of them, by the patch alone.
    level_cost : ndarray, float32 [rows, columns, L]
        Against every blur level, motions weighed by how likely they are beside the neighbours'.
    vectors_px : ndarray of float64 [M, 2]
        What the motions exactly are, where they occur.
    """

    motion: NDArray[np.intp]
    candidates: NDArray[np.intp]
    probability: NDArray[np.float32]
    level_cost: NDArray[np.float32]
    vectors_px: NDArray[np.float64]


def separate(
    evidence: NDArray[np.float32], motions: Motions, config: MotionConfig, overlap: float
) -> Separated:
    """Choose the motions of all patches together, and take them out of the evidence on depth.

    Thesis eq. 7.4 has total variation of depth and of motion beside the data. Here the few motions
    that occur are found first, whatever the depth; each patch gets one of them, semi-globally; and
    then the depth follows under what has become of the motions: not only the chosen one counts,
    but each as far as its neighbours allow for it.

    Parameters
    ----------
    evidence : ndarray, float32 [M, L, rows, columns]
        Against every pair of motion and level, natural logarithm, 0 for the likeliest.
    overlap : float
        Width of the patches over the distance between them.
    """
    likelihood = np.exp(-evidence)
    probability = likelihood.sum(axis=1)
    probability /= probability.sum(axis=0)
    of_motion = -np.log(np.maximum(probability, np.float32(1e-30)))
    of_motion -= of_motion.min(axis=0)
    some = occurring_motions(of_motion, motions, overlap)
    still = np.hypot(*motions.vectors_px.T) == 0
    handicap = np.where(still, 0, config.motion_threshold).astype(np.float32)[some, None, None]
    known = of_motion[some] + handicap
    known = np.minimum(known - known.min(axis=0), np.float32(_ENOUGH_EVIDENCE))
    neighbours = _neighbours(motions)
    total = _semi_global(known, _within(neighbours, some), config.motion_smoothness)
    motion = some[total.argmin(axis=0)]
    vectors = motions.vectors_px.copy()
    for index in some[~still[some]]:
        here = motion == index
        if here.any():
            of_all = np.minimum(of_motion[:, here], np.float32(_ENOUGH_TO_REFINE)).sum(axis=1)
            vectors[index] = refined_motion(of_all, motions, int(index))
    others = total - known + handicap
    others -= others.min(axis=0)
    # Others count as well, at a price: a smooth patch may look like none of those that occur.
    against = np.broadcast_to(others.min(axis=0) + np.float32(_OTHERS), probability.shape).copy()
    for index, cost in zip(some, others, strict=True):
        # What moves may do so a little differently.
        near = [index] if still[index] else [index, *neighbours[index]]
        against[near] = np.minimum(against[near], cost)
    weighed = np.einsum("mlrc,mrc->lrc", likelihood, np.exp(-against))
    level = -np.log(np.maximum(weighed, np.float32(1e-30)))
    level -= level.min(axis=0)
    every = np.arange(len(motions))[:, None, None]
    candidates = np.broadcast_to(every, probability.shape)
    return Separated(motion, candidates, probability, np.moveaxis(level, 0, -1), vectors)


def separate_expected(
    evidence: NDArray[np.float32], candidates: NDArray[np.intp], motions: Motions
) -> Separated:
    """Choose among a few motions that were expected; neighbours are as good already.

    Parameters
    ----------
    evidence : ndarray, float32 [k, L, rows, columns]
        Against every pair of candidate and level.
    candidates : ndarray of int [rows, columns, k]
        Which motions they are.
    """
    likelihood = np.exp(-evidence)
    probability = likelihood.sum(axis=1)
    probability /= probability.sum(axis=0)
    level = -np.log(np.maximum(likelihood.sum(axis=0), np.float32(1e-30)))
    level -= level.min(axis=0)
    tried = np.moveaxis(candidates, -1, 0)
    motion = np.take_along_axis(tried, probability.argmax(axis=0)[None], axis=0)[0]
    level = np.moveaxis(level, 0, -1)
    return Separated(motion, tried, probability, level, motions.vectors_px)


def _neighbours(motions: Motions) -> NDArray[np.intp]:
    """Return the nearest of each motion [M, n]."""
    order = np.argsort(motions.distances_px(motions.vectors_px), axis=1)
    return np.asarray(order[:, 1 : 1 + min(_NEIGHBOURS, len(motions) - 1)])


def _within(neighbours: NDArray[np.intp], some: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return which of some motions are neighbours [m, n], as numbers of these; else its own."""
    number = np.full(len(neighbours), -1)
    number[some] = np.arange(len(some))
    of_some = number[neighbours[some]]
    return np.where(of_some < 0, np.arange(len(some))[:, None], of_some)


def _semi_global(
    known: NDArray[np.float32], neighbours: NDArray[np.intp], smoothness: float
) -> NDArray[np.float32]:
    """Minimise along rows and columns, both ways, and add up, as `depth` does with levels.

    Takes and gives [m, rows, columns].
    """
    of_rows = np.moveaxis(known, 0, 1)  # [rows, M, columns]
    of_columns = np.moveaxis(known, (2, 1), (0, 2))  # [columns, M, rows]
    down = _both_ways(of_rows, neighbours, smoothness)
    across = _both_ways(of_columns, neighbours, smoothness)
    total = np.moveaxis(down, 1, 0) + np.moveaxis(across, (0, 2), (2, 1))
    return total - 3 * known  # every path counts the evidence of its patch


def _both_ways(
    evidence: NDArray[np.float32], neighbours: NDArray[np.intp], smoothness: float
) -> NDArray[np.float32]:
    """Add up the costs of the best paths that reach each patch along the first axis."""
    slight, jump = np.float32(_SLIGHT_STEP * smoothness), np.float32(_JUMP * smoothness)
    costs = np.stack([evidence, evidence[::-1]], axis=1)  # [n, 2, M, m]
    for i in range(1, len(costs)):
        previous = costs[i - 1] - costs[i - 1].min(axis=1, keepdims=True)
        best = np.minimum(previous, jump)
        if neighbours.shape[1]:
            near = previous[:, neighbours[:, 0]]
            for column in neighbours.T[1:]:
                near = np.minimum(near, previous[:, column])
            best = np.minimum(best, near + slight)
        costs[i] += best
    return np.asarray(costs[:, 0] + costs[::-1, 1])
