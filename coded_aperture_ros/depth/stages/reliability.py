"""Confidence of a bank for which the decoder's is not right, such as one of a phase mask.

It was measured with the network where that supports the bank; for classical regularisation, whose
confidence is lower, it is too modest.
"""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Plan, Stage, Work

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "reliability"
# Confidences nearer to 0 and 1 count as these, and noise beyond these, linear light.
_SURE = 1e-4
_NOISES = (0.001, 0.03)


def reliability_terms(confidence: FloatArray, noise: float) -> DoubleArray:
    """Terms of the log-odds that a confidence is right [3, ...]: 1, its log-odds, log of the noise.

    Parameters
    ----------
    confidence : ndarray, float32 [...]
        Of the decoder.
    noise : float
        Standard deviation of one channel's noise, linear light.
    """
    certain = np.clip(confidence.astype(np.float64), _SURE, 1 - _SURE)
    of_noise = np.full_like(certain, np.log(np.clip(noise, *_NOISES)))
    return np.stack([np.ones_like(certain), np.log(certain / (1 - certain)), of_noise])


def make(plan: Plan, config: object) -> Stage:
    """Stage of the reliability that is stored in the plan's bank."""
    return Reliability(np.array(plan.reliability))


@dataclasses.dataclass(frozen=True, eq=False)
class Reliability(Stage):
    """Makes the confidence what was measured with the bank's PSFs; 0 stays 0."""

    coefficients: DoubleArray  # [3]; of the `reliability_terms`
    name = "reliability"

    def __call__(self, work: Work) -> None:
        """Change the log-odds of the confidence."""
        terms = reliability_terms(work.confidence, work.observation.channel_noise)
        measured = 1 / (1 + np.exp(-np.tensordot(self.coefficients, terms, axes=1)))
        measured = measured.astype(np.float32)
        work.confidence = np.where(work.confidence > 0, measured, work.confidence)
