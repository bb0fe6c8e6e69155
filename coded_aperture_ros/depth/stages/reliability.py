"""Confidence of a bank for which the decoder's is not right, such as one of a phase mask."""

import dataclasses

import numpy as np

from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Plan, Stage, Work

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "reliability"
# Confidences nearer to 0 and 1 count as these.
_SURE = np.float32(1e-4)


def make(plan: Plan, config: object) -> Stage:
    """Stage of the reliability that is stored in the plan's bank."""
    offset, factor = plan.reliability
    return Reliability(offset, factor)


@dataclasses.dataclass(frozen=True, eq=False)
class Reliability(Stage):
    """Makes the confidence what was measured with the bank's PSFs; 0 stays 0."""

    offset: float
    factor: float
    name = "reliability"

    def __call__(self, work: Work) -> None:
        """Change the log-odds of the confidence."""
        certain = np.clip(work.confidence, _SURE, 1 - _SURE)
        odds = self.offset + self.factor * np.log(certain / (1 - certain))
        measured = (1 / (1 + np.exp(-odds))).astype(np.float32)
        work.confidence = np.where(work.confidence > 0, measured, work.confidence)
