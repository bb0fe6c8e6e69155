"""From the network's logits to blur sizes, their spread and how likely they are right."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.depth.refine.network import Logits

# The blur size is the mean over so many bins on either side of the likeliest.
REACH = 2
# Share of errors within one standard deviation, and the surest that this is taken from.
_WITHIN_ONE, _SUREST = 0.68, 0.98
_LOG_WIDTHS = (-4.0, 2.0)


@dataclasses.dataclass(frozen=True, eq=False)
class HalfCells:
    """What is found of every half-cell [rows, columns]; float32."""

    size_px: FloatArray  # blur size without sign: the mean around the likeliest three
    width_px: FloatArray  # mean error of it, if it is about right
    about: FloatArray  # probability that it is about right: that of the bins that it is the mean of
    # [tried, rows, columns]; of every blur size that was tried, but for the factor `scale`.
    probability: FloatArray
    scale: FloatArray  # [rows, columns]; see `probability`
    tried_px: FloatArray  # [tried]; the blur sizes that were tried

    @classmethod
    def of(cls, logits: Logits, tried_px: FloatArray) -> "HalfCells":
        """Interpret logits."""
        shape, count = logits.log_width.shape, len(tried_px)
        flat = logits.size.reshape(count, -1)
        probability = np.exp(flat - flat.max(axis=0))
        # With its neighbours: a blur size between two bins shares its probability among them.
        together = probability.copy()
        together[1:] += probability[:-1]
        together[:-1] += probability[1:]
        best = together.argmax(axis=0)
        places = np.arange(flat.shape[1])
        total, mean = (np.zeros(flat.shape[1], np.float32) for _ in range(2))
        for step in range(-REACH, REACH + 1):
            at = best + step
            weight = probability[np.clip(at, 0, count - 1), places]
            weight *= (at >= 0) & (at < count)
            total += weight
            mean += weight * np.float32(step)
        step_px = tried_px[1] - tried_px[0]
        size = tried_px[best] + mean / total * step_px
        scale = 1 / probability.sum(axis=0)
        return cls(
            size.reshape(shape),
            np.exp(np.clip(logits.log_width, *_LOG_WIDTHS)),
            (total * scale).reshape(shape),
            probability.reshape(count, *shape),
            scale.reshape(shape),
            tried_px,
        )

    def right_within(self, tolerance_px: FloatArray) -> FloatArray:
        """Return how likely the blur size is right to a tolerance [rows, columns]."""
        return np.asarray(self.about * (1 - np.exp(-tolerance_px / self.width_px)), np.float32)

    def deviation_px(self) -> FloatArray:
        """Return the distance that errors are within as often as within a standard deviation."""
        share = np.minimum(_WITHIN_ONE / self.about, _SUREST)
        deviation = -self.width_px * np.log1p(-share)
        count = len(self.tried_px)
        powers = np.stack([self.tried_px, self.tried_px**2])
        moments = powers @ self.probability.reshape(count, -1)
        first, second = moments.reshape(2, *self.scale.shape) * self.scale
        spread = second - 2 * first * self.size_px + self.size_px**2
        # Where the likeliest is not likely, errors are as large as the others are far.
        unlikely = self.about < _WITHIN_ONE
        return np.where(unlikely, np.maximum(deviation, np.sqrt(np.maximum(spread, 0))), deviation)

    def quantile_px(self, share: float) -> FloatArray:
        """Return the blur size that the true one is below with a probability [rows, columns]."""
        rank = (np.cumsum(self.probability * self.scale, axis=0) < share).sum(axis=0)
        return self.tried_px[np.minimum(rank, len(self.tried_px) - 1)]


def chosen_neighbours(neighbour: IndexArray) -> IndexArray:
    """Return for each quarter of each half-cell whose blur size it has [2 rows, 2 columns].

    From `Logits.neighbour` [4, rows, columns], as flat indices into [rows, columns].
    """
    _, rows, columns = neighbour.shape
    down = np.clip(np.arange(rows)[:, None] + neighbour // 3 - 1, 0, rows - 1)
    right = np.clip(np.arange(columns) + neighbour % 3 - 1, 0, columns - 1)
    flat = (down * columns + right).reshape(2, 2, rows, columns)
    return np.ascontiguousarray(flat.transpose(2, 0, 3, 1)).reshape(2 * rows, 2 * columns)


def drawn(values: FloatArray, quarters: IndexArray, one_surface: float) -> FloatArray:
    """Return a map of half-cells' values at every pixel.

    Linear within a surface, where neighbours differ by at most `one_surface`; elsewhere every
    quarter has the value of the half-cell that was chosen.
    """
    pixels = (4 * values.shape[1], 4 * values.shape[0])
    linear = cv2.resize(values, pixels, interpolation=cv2.INTER_LINEAR)
    around = np.ones((3, 3), np.uint8)
    even = (cv2.dilate(values, around) - cv2.erode(values, around) <= one_surface).view(np.uint8)
    even = cv2.resize(even, pixels, interpolation=cv2.INTER_NEAREST)
    edges = cv2.resize(values.ravel()[quarters], pixels, interpolation=cv2.INTER_NEAREST)
    return np.where(even.view(bool), linear, edges)
