"""Calibration of the network's probabilities, which its weights' file holds."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray, as_floats

# Of weights' files that state none: fitted for the weights of the time.
_FORMER_COEFFICIENTS = (-0.58, 1.45, 0.071, -0.5)
_FORMER_DEVIATION = 0.78
# Probabilities are taken as at least so far from 0 and 1: their logarithm must be finite.
_SURE = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """What makes a confidence and a standard deviation of the network's probabilities.

    Fitted on random scenes kept apart, by `training/train.py refinement calibrate`. The network
    doubts wide blur too much, and too little what may be wrong by many pixels.

    Attributes
    ----------
    coefficients : ndarray, float32 [4]
        Of the logarithm of the odds that a depth is right: a constant, and the factors of the
        logarithm of the network's odds, of the blur size in px, and of the logarithm of the
        tolerance in px.
    deviation : float32
        Factor of the standard deviation of the network's blur sizes.
    """

    coefficients: FloatArray
    deviation: np.float32

    @classmethod
    def from_weights(cls, arrays: Mapping[str, NDArray[Any]]) -> "Calibration":
        """Calibration in a weights' file (`calibration`, `deviation`); files may lack it."""
        coefficients = arrays.get("calibration", np.array(_FORMER_COEFFICIENTS))
        deviation = arrays.get("deviation", np.array(_FORMER_DEVIATION))
        return cls(as_floats(coefficients), np.float32(deviation))

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays of the weights' file, by their names."""
        return {"calibration": self.coefficients, "deviation": np.array(self.deviation)}

    def confidence(
        self, probability: FloatArray, size_px: FloatArray, tolerance_px: FloatArray
    ) -> FloatArray:
        """Probability that depths are right, 0 to 1.

        Parameters
        ----------
        probability : ndarray, float32
            Network's probability of an error below the tolerance.
        size_px, tolerance_px : ndarray, float32
            Blur size, and its largest error of a right depth.
        """
        offset, of_odds, of_size, of_tolerance = self.coefficients
        odds = log_odds(probability)
        found = offset + of_odds * odds + of_size * size_px + of_tolerance * np.log(tolerance_px)
        return np.asarray(1 / (1 + np.exp(-found)), np.float32)


def log_odds(probability: FloatArray) -> FloatArray:
    """Natural logarithm of the odds of a probability, float32."""
    certain = np.clip(probability, _SURE, 1 - _SURE)
    return np.asarray(np.log(certain / (1 - certain)), np.float32)
