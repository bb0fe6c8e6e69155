"""Masks of which none is better than another in every respect."""

import dataclasses

import numpy as np
from numpy.typing import NDArray


@dataclasses.dataclass(frozen=True, eq=False)
class Front:
    """Masks that no other mask found beats in depth, deblurring and light at once.

    The least depth error comes first. Of all scores less is better.
    """

    grids: NDArray[np.bool_]  # [F, n, n]
    scores: NDArray[np.float64]  # [F, 3]: depth error, deblurring error, closed share (1 - light)

    @staticmethod
    def empty(cells: int) -> "Front":
        """Return a front without masks."""
        return Front(np.zeros((0, cells, cells), bool), np.zeros((0, 3)))

    def with_masks(
        self, grids: NDArray[np.bool_], scores: NDArray[np.float64], most: int
    ) -> "Front":
        """Return the front of these and more masks, of at most `most`.

        Where there are too many, those that differ least in depth error from their neighbour go.
        """
        grids = np.concatenate([self.grids, grids])
        scores = np.concatenate([self.scores, scores])
        _, first = np.unique(grids.reshape(len(grids), -1), axis=0, return_index=True)
        first = first[not_beaten(scores[first])]
        first = first[np.lexsort((first, scores[first, 0]))]
        while len(first) > most:
            gaps = np.diff(np.log(scores[first, 0]))
            first = np.delete(first, 1 + int(np.argmin(gaps)))
        return Front(grids[first], scores[first])


def not_beaten(scores: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which rows [N, objectives] no other row is at least as good as in all, and better in one."""
    keep = np.ones(len(scores), bool)
    for index, score in enumerate(scores):
        if keep[index]:
            worse = (scores >= score).all(axis=1) & (scores > score).any(axis=1)
            keep &= ~worse
    return keep
