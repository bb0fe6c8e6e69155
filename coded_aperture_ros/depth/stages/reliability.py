"""Confidence of a bank for which the decoder's is not right, such as one of a phase mask.

It was measured with the network where that supports the bank; for classical regularisation, whose
confidence is lower, it is too modest.
"""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, constant, namespace
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
    xp = namespace(confidence)
    certain = xp.clip(xp.asarray(confidence, dtype=xp.float64), _SURE, 1 - _SURE)
    of_noise = xp.full_like(certain, float(np.log(np.clip(noise, *_NOISES))))
    return xp.stack([xp.ones_like(certain), xp.log(certain / (1 - certain)), of_noise])


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
        xp, coefficients = namespace(terms), constant(self.coefficients, terms)
        measured = 1 / (1 + xp.exp(-xp.tensordot(coefficients, terms, 1)))
        measured = xp.asarray(measured, dtype=xp.float32)
        work.confidence = xp.where(work.confidence > 0, measured, work.confidence)
