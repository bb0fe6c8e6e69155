"""Whether a confidence puts the errors in order: what is left when the least sure are left out."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError


@dataclasses.dataclass(frozen=True, eq=False)
class Sparsification:
    """Mean error of the most confident estimates over their share, the coverage.

    Attributes
    ----------
    error : ndarray of float64, shape [n]
        Mean error of the k most confident of the n estimates, for k = 1 to n.
    oracle : ndarray of float64, shape [n]
        The same where the estimates are in the order of their errors.
    """

    error: DoubleArray
    oracle: DoubleArray

    @classmethod
    def of(cls, errors: NDArray[np.floating], confidence: NDArray[np.floating]) -> "Sparsification":
        """Sort estimates by their confidence, and by their errors.

        Parameters
        ----------
        errors : ndarray of float, shape [n]
            Not negative and finite.
        confidence : ndarray of float, shape [n]
            Anything that is larger where the estimate is surer. Estimates of equal confidence
            stand for each other, each with their mean error.

        Raises
        ------
        InputError
            If the shapes differ.
        """
        if errors.shape != confidence.shape:
            raise InputError(
                f"errors and confidence: expected one shape, got {list(errors.shape)} and "
                f"{list(confidence.shape)}"
            )
        errors = errors.astype(np.float64).ravel()
        _, group, count = np.unique(-confidence.ravel(), return_inverse=True, return_counts=True)
        mean_of_group = np.bincount(group.ravel(), errors) / count
        return cls(
            error=_running_mean(np.repeat(mean_of_group, count)),
            oracle=_running_mean(np.sort(errors)),
        )

    @property
    def area(self) -> float:
        """Area below the curve of the errors, over coverages from 0 to 1; NaN without any."""
        return float(np.mean(self.error)) if self.error.size else float("nan")

    @property
    def area_over_oracle(self) -> float:
        """Area between the curve and the oracle's (AUSE, in units of the error); NaN without any.

        0 for a confidence that puts the errors in their order; the less, the better.
        """
        return float(np.mean(self.error - self.oracle)) if self.error.size else float("nan")

    def at(self, coverage: NDArray[np.floating]) -> tuple[DoubleArray, DoubleArray]:
        """Return both curves at some coverages, above 0 and at most 1; at least one estimate."""
        count = self.error.size
        index = np.clip(np.ceil(coverage * count).astype(np.intp) - 1, 0, count - 1)
        return self.error[index], self.oracle[index]


def _running_mean(values: DoubleArray) -> DoubleArray:
    return np.cumsum(values) / np.arange(1, values.size + 1)
