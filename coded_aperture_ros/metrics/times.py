"""Summary of durations: medians and 99th percentiles, not means, as a camera does not wait."""

import dataclasses
from collections.abc import Sequence

import numpy as np


@dataclasses.dataclass(frozen=True)
class Times:
    """Distribution of durations, ms; of few samples, p99 is the largest."""

    samples: int
    p50_ms: float
    p99_ms: float
    worst_ms: float

    @classmethod
    def from_seconds(cls, seconds: Sequence[float], factor: float = 1.0) -> "Times":
        """Summary of durations in seconds, each multiplied by a factor."""
        p50, p99, worst = 1000 * factor * np.quantile(seconds, [0.5, 0.99, 1.0])
        return cls(len(seconds), float(p50), float(p99), float(worst))
