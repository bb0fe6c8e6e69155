"""Reliability of a confidence: how often estimates of a given confidence are right."""

import dataclasses
from functools import reduce
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray
from coded_aperture_ros.core.errors import InputError

BINS = 10


@dataclasses.dataclass(frozen=True, eq=False)
class Reliability:
    """Reliability diagram: estimates sorted into equal bins of confidence from 0 to 1.

    Diagrams of several frames add up with ``+``.

    Examples
    --------
    >>> import numpy as np
    >>> confidence = np.array([0.95, 0.95, 0.15, 0.15])
    >>> right = np.array([True, True, True, False])
    >>> found = Reliability.from_estimates(confidence, right)
    >>> round(found.expected_calibration_error, 6)
    0.2
    """

    count: NDArray[np.int64]  # [bins]; estimates in each bin
    confidence_sum: DoubleArray  # [bins]; sum of their confidences
    right: NDArray[np.int64]  # [bins]; how many of them are right

    @classmethod
    def from_estimates(
        cls, confidence: NDArray[np.floating], right: BoolArray, bins: int = BINS
    ) -> "Reliability":
        """Diagram of estimates with a confidence in [0, 1]; `right`: which of them are right.

        Raises `InputError` if the shapes differ or a confidence is not in [0, 1].
        """
        if confidence.shape != right.shape:
            raise InputError(
                f"confidence and right: expected one shape, got {list(confidence.shape)} and "
                f"{list(right.shape)}"
            )
        values = confidence.ravel()
        if values.size and not (values.min() >= 0 and values.max() <= 1):
            raise InputError("confidence: expected values in [0, 1]")
        index = np.minimum((values * bins).astype(np.intp), bins - 1)
        # Both counts at once: a video has many of them.
        wrong, good = np.bincount(index + bins * right.ravel(), minlength=2 * bins).reshape(2, bins)
        return cls(
            count=wrong + good,
            confidence_sum=np.bincount(index, values, minlength=bins).astype(np.float64),
            right=good,
        )

    @classmethod
    def total(cls, parts: "list[Reliability]") -> "Reliability":
        """Sum of at least one diagram."""
        return reduce(add, parts)

    def __add__(self, other: "Reliability") -> "Reliability":
        return Reliability(
            self.count + other.count,
            self.confidence_sum + other.confidence_sum,
            self.right + other.right,
        )

    @property
    def mean_confidence(self) -> DoubleArray:
        """Mean confidence of each bin [bins]; NaN for an empty one."""
        return self._per_estimate(self.confidence_sum)

    @property
    def share_right(self) -> DoubleArray:
        """Share of right estimates of each bin [bins]; NaN for an empty one."""
        return self._per_estimate(self.right)

    @property
    def expected_calibration_error(self) -> float:
        """Mean over the estimates of |confidence - share right| of their bin; NaN if empty."""
        if not self.count.any():
            return float("nan")
        return float(np.abs(self.confidence_sum - self.right).sum() / self.count.sum())

    def rows(self) -> list[dict[str, Any]]:
        """Bins that are not empty, for a table or JSON."""
        edges = np.linspace(0, 1, len(self.count) + 1)
        return [
            {
                "from": round(float(low), 4),
                "to": round(float(high), 4),
                "count": int(count),
                "confidence": round(float(promised), 4),
                "share_right": round(float(kept), 4),
            }
            for low, high, count, promised, kept in zip(
                edges, edges[1:], self.count, self.mean_confidence, self.share_right, strict=False
            )
            if count
        ]

    def _per_estimate(self, sums: NDArray) -> DoubleArray:
        none = np.full(len(sums), np.nan)
        return np.divide(sums, self.count, out=none, where=self.count > 0)
