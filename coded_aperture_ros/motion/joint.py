"""Choosing motion and depth together: what one knows of the other, and of its neighbours."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.motion.config import MotionConfig
from coded_aperture_ros.motion.kernels import Motions

# Evidence against a motion counts up to here; beyond, it is an outlier (natural logarithm).
_ENOUGH_EVIDENCE = 7.0
# Motions that are neighbours of each, between which a patch and the next change easily.
_NEIGHBOURS = 6
# Weights of the smoothness beside natural-logarithm evidence.
_SLIGHT_STEP = 6.0
_JUMP = 36.0


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
    level_evidence : ndarray, float32 [rows, columns, L]
        Against every blur level, motions weighed by how likely they are beside the neighbours'.
    """

    motion: NDArray[np.intp]
    candidates: NDArray[np.intp]
    probability: NDArray[np.float32]
    level_evidence: NDArray[np.float32]


def separate(evidence: NDArray[np.float32], motions: Motions, config: MotionConfig) -> Separated:
    """Choose the motions of all patches together, and take them out of the evidence on depth.

    Thesis eq. 7.4 has total variation of depth and of motion beside the data; here the motions are
    regularised first, whatever the depth, semi-globally, and the depth then under what has become
    of the motions: not only the chosen one counts, but each as far as its neighbours allow for it.

    Parameters
    ----------
    evidence : ndarray, float32 [M, L, rows, columns]
        Against every pair of motion and level, natural logarithm, 0 for the likeliest.
    motions : Motions
    config : MotionConfig
    """
    likelihood = np.exp(-evidence)
    still = np.hypot(*motions.vectors_px.T) == 0
    handicap = np.where(still, 0, config.stillness).astype(np.float32)[:, None, None]
    of_motion = likelihood.sum(axis=1)
    probability = of_motion * np.exp(-handicap)
    probability /= probability.sum(axis=0)
    known = -np.log(np.maximum(probability, np.float32(np.exp(-_ENOUGH_EVIDENCE))))
    total = _semi_global(known, motions, config.motion_smoothness)
    others = total - known + handicap
    others -= others.min(axis=0)
    weighed = np.einsum("mlrc,mrc->lrc", likelihood, np.exp(-others))
    level = -np.log(np.maximum(weighed, np.float32(1e-30)))
    level -= level.min(axis=0)
    every = np.arange(len(motions))[:, None, None]
    candidates = np.broadcast_to(every, probability.shape)
    return Separated(total.argmin(axis=0), candidates, probability, np.moveaxis(level, 0, -1))


def separate_expected(evidence: NDArray[np.float32], candidates: NDArray[np.intp]) -> Separated:
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
    return Separated(motion, tried, probability, np.moveaxis(level, 0, -1))


def _semi_global(
    known: NDArray[np.float32], motions: Motions, smoothness: float
) -> NDArray[np.float32]:
    """Minimise along rows and columns, both ways, and add up, as `depth` does with levels.

    Takes and gives [M, rows, columns].
    """
    count = len(motions)
    order = np.argsort(motions.distances_px(motions.vectors_px), axis=1)
    neighbours = order[:, 1 : 1 + min(_NEIGHBOURS, count - 1)]
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
