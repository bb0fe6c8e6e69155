"""What is believed of every pixel's depth."""

import dataclasses
from functools import cached_property

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray

# Every fourth row and column is enough for a median.
_SPARSE = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Belief:
    """Gaussian of every pixel's inverse depth, and how likely it is about right.

    Attributes
    ----------
    inverse : ndarray, float32 [rows, columns]
        Inverse depth, 1/m; 0 at infinity.
    variance : ndarray, float32 [rows, columns]
        Of the inverse depth, where it is right.
    confidence : ndarray, float32 [rows, columns]
        Probability, in [0, 1], that it is; 0: nothing is known.
    """

    inverse: FloatArray
    variance: FloatArray
    confidence: FloatArray

    @property
    def maps(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Inverse depth, variance and confidence, contiguous."""
        inverse, variance, confidence = (
            np.ascontiguousarray(values)
            for values in (self.inverse, self.variance, self.confidence)
        )
        return inverse, variance, confidence

    @cached_property
    def middle(self) -> float:
        """About the median of the inverse depth, 1/m."""
        return float(np.median(self.inverse[::_SPARSE, ::_SPARSE]))
