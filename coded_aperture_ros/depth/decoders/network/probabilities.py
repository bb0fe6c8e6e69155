"""From the network's logits to blur sizes, their spread and how likely they are right."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network.network import Logits, to_half_cells

# The blur size is the mean over so many bins on either side of the likeliest.
REACH = 2
# Share of errors within one standard deviation, and the surest that this is taken from.
_WITHIN_ONE = 0.68
_SUREST = 0.98
_LOG_WIDTHS = (-4.0, 2.0)
_NEVER = np.float32(1e-6)
# Half-cells that are interpreted together: no more than a core's cache holds.
_PLACES = 5376


@dataclasses.dataclass(frozen=True, eq=False)
class HalfCells:
    """What is found of every half-cell [rows, columns]; float32."""

    size_px: FloatArray  # blur size without sign: the mean around the likeliest three
    about: FloatArray  # probability that it is about right: that of the bins that it is the mean of
    spread_px: FloatArray  # standard deviation of all blur sizes from it
    width_px: FloatArray  # mean error of it, if it is about right
    logits: FloatArray  # [tried, rows, columns]; of every blur size that was tried
    tried_px: FloatArray  # [tried]; the blur sizes that were tried

    @classmethod
    def of(
        cls, logits: Logits, tried_px: FloatArray, workers: Workers | None = None
    ) -> "HalfCells":
        """Interpret logits; `workers` share the work."""
        flat = logits.size.reshape(len(tried_px), -1)
        steps = np.arange(-REACH, REACH + 1, dtype=np.float32)
        sums = np.stack([np.ones_like(tried_px), tried_px, tried_px**2])
        found = np.empty((3, flat.shape[1]), np.float32)

        def interpret(first: int, _: int) -> None:
            places = np.s_[:, first : first + _PLACES]
            some = flat[places]
            padded = np.zeros((len(some) + 2 * REACH, some.shape[1]), np.float32)
            probability = np.exp(some - some.max(axis=0), out=padded[REACH:-REACH])
            # With its neighbours: a blur size between two bins shares its probability among them.
            together = padded[REACH - 1 : -REACH - 1] + probability
            together += padded[REACH + 1 : len(padded) - REACH + 1]
            best = (together == together.max(axis=0)).argmax(axis=0)
            around = np.take_along_axis(padded, best + np.arange(len(steps))[:, None], axis=0)
            about = around.sum(axis=0)
            size = tried_px[best] + steps @ around / about * (tried_px[1] - tried_px[0])
            total, mean, square = sums @ probability
            square = (square - 2 * mean * size) / total + size**2
            found[places] = size, about / total, np.sqrt(np.maximum(square, 0))

        (workers or Workers()).each(interpret, range(0, flat.shape[1], _PLACES))
        width = np.exp(np.clip(logits.log_width, *_LOG_WIDTHS))
        size, about, spread = found.reshape(3, *width.shape)
        return cls(size, about, spread, width, logits.size, tried_px)

    def right_within(self, tolerance_px: FloatArray) -> FloatArray:
        """Return how likely the blur size is right to a tolerance [rows, columns]."""
        return np.asarray(self.about * (1 - np.exp(-tolerance_px / self.width_px)), np.float32)

    def deviation_px(self) -> FloatArray:
        """Return the distance that errors are within as often as within a standard deviation."""
        share = np.minimum(_WITHIN_ONE / self.about, _SUREST)
        deviation = -self.width_px * np.log1p(-share)
        # Where the likeliest is not likely, errors are as large as the others are far.
        larger = np.maximum(deviation, self.spread_px)
        return np.where(self.about < _WITHIN_ONE, larger, deviation)

    def nearest_px(self, probability: float, far: FloatArray) -> FloatArray:
        """Return the signed size with so much probability nearer; `far`: that of lying beyond."""
        share, doubt = np.float32(probability), np.maximum(1 - far, _NEVER)
        # Before the focal plane the nearer surface is the more blurred one.
        before = -self.quantile_px(1 - np.minimum(share / doubt, 1))
        beyond = self.quantile_px((share - doubt) / np.maximum(far, _NEVER))
        return np.where(doubt < share, beyond, before)

    def quantile_px(self, share: float | NDArray[np.floating]) -> FloatArray:
        """Return the blur size that the true one is below with a probability [rows, columns]."""
        probability = np.exp(self.logits - self.logits.max(axis=0))
        left = share * probability.sum(axis=0)
        rank = np.zeros(left.shape, np.intp)
        for each in probability[:-1]:
            left -= each
            rank += left > 0
        return self.tried_px[rank]


def chosen_neighbours(neighbour: NDArray[np.uint8]) -> IndexArray:
    """Return for each quarter of each half-cell whose blur size it has [2 rows, 2 columns].

    From `Logits.neighbour` [4, rows, columns], as flat indices into all with a border of one.
    """
    _, rows, columns = neighbour.shape
    corner = np.add.outer((columns + 2) * np.arange(rows), np.arange(columns))
    beyond = np.add.outer((columns + 2) * np.arange(3), np.arange(3)).ravel()
    return np.asarray(to_half_cells(corner + beyond[neighbour])[0])
