"""From the network's logits to blur sizes, their spread and how likely they are right."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.depth.refine.features import BLUR_SIZES_PX, BLUR_STEP_PX

# The blur size is the mean over so many bins on either side of the likeliest.
REACH = 2
# Neighbours around a half-cell that a quarter of it may belong to.
_NEIGHBOURS = 9
# Share of errors within one standard deviation.
_WITHIN_ONE = 0.68
_LEAST_WIDTH_PX = 0.02


@dataclasses.dataclass(frozen=True, eq=False)
class HalfCells:
    """What is found of every half-cell [rows, columns]; float32.

    Attributes
    ----------
    size_px : ndarray
        Signed blur size.
    width_px : ndarray
        Mean error of it, if it is about right.
    probability : ndarray [tried, rows, columns]
        Of every blur size that was tried.
    tried_px : ndarray [tried]
        These.
    """

    size_px: FloatArray
    width_px: FloatArray
    probability: FloatArray
    tried_px: FloatArray

    @classmethod
    def of(cls, logits: FloatArray, tried: BoolArray) -> "HalfCells":
        """Interpret logits [bins + 1, rows, columns]."""
        tried_px = BLUR_SIZES_PX[tried].astype(np.float32)
        first = int(np.flatnonzero(tried)[0])
        probability = logits[first : first + len(tried_px)]
        best = probability.argmax(axis=0)
        probability = probability - probability.max(axis=0)
        np.exp(probability, out=probability)
        total = np.zeros_like(probability[0])
        mean = np.zeros_like(total)
        for step in range(-REACH, REACH + 1):
            at = best + step
            there = (at >= 0) & (at < len(tried_px))
            index = np.clip(at, 0, len(tried_px) - 1)
            weight = np.take_along_axis(probability, index[None], axis=0)[0] * there
            total += weight
            mean += weight * tried_px[index]
        probability /= probability.sum(axis=0)
        width = np.exp(np.clip(logits[-1], -5, 2))
        return cls(mean / total, np.maximum(width, _LEAST_WIDTH_PX), probability, tried_px)

    def mass_within(self, distance_px: FloatArray) -> FloatArray:
        """Return how probable blur sizes at most so far from the chosen one are."""
        up_to = np.zeros((len(self.tried_px) + 1, *self.size_px.shape), np.float32)
        np.cumsum(self.probability, axis=0, out=up_to[1:])
        first, step = self.tried_px[0], np.float32(BLUR_STEP_PX)

        def below(size_px: FloatArray) -> FloatArray:
            place = np.clip((size_px - first) / step + 0.5, 0, len(self.tried_px))
            index = np.minimum(place.astype(np.intp), len(self.tried_px) - 1)
            low, high = (
                np.take_along_axis(up_to, (index + more)[None], axis=0)[0] for more in (0, 1)
            )
            return low + (place - index) * (high - low)

        return below(self.size_px + distance_px) - below(self.size_px - distance_px)

    def right_within(self, tolerance_px: FloatArray) -> FloatArray:
        """Return how likely the blur size is right to a tolerance.

        The bins tell whether it is about right, the width how exact it is then.
        """
        about = self.mass_within(np.maximum(tolerance_px, (REACH + 0.5) * BLUR_STEP_PX))
        return np.asarray(about * (1 - np.exp(-tolerance_px / self.width_px)), np.float32)

    def deviation_px(self) -> FloatArray:
        """Return the distance that errors are within as often as within a standard deviation."""
        about = self.mass_within(np.full_like(self.size_px, (REACH + 0.5) * BLUR_STEP_PX))
        share = np.minimum(_WITHIN_ONE / np.maximum(about, 1e-3), 0.98)
        near = -self.width_px * np.log1p(-share)
        offsets = self.tried_px[:, None, None] - self.size_px
        far = np.sqrt((self.probability * offsets * offsets).sum(axis=0))
        return np.where(about > _WITHIN_ONE, np.minimum(near, np.maximum(far, near * 0)), far)

    def quantile_px(self, share: float) -> FloatArray:
        """Return the blur size that the true one is nearer than with a probability."""
        rank = (np.cumsum(self.probability, axis=0) < share).sum(axis=0)
        return self.tried_px[np.minimum(rank, len(self.tried_px) - 1)]


def chosen_neighbours(choice: FloatArray) -> IndexArray:
    """Return for each quarter of each half-cell whose blur size it has [2 rows, 2 columns].

    From the logits [4 * 9, rows, columns], as flat indices into [rows, columns].
    """
    _, rows, columns = choice.shape
    best = choice.reshape(4, _NEIGHBOURS, rows, columns).argmax(axis=1)
    down = np.clip(np.arange(rows)[:, None] + best // 3 - 1, 0, rows - 1)
    right = np.clip(np.arange(columns) + best % 3 - 1, 0, columns - 1)
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
