"""The side of the focal plane, from the phase of the spectrum."""

import dataclasses

from coded_aperture_ros.depth.decoders.sides import FocalSides
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Plan, Stage, Work

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "sides"


def make(plan: Plan, config: object) -> Stage:
    """Stage of levels on both sides of the focal plane."""
    assert plan.sides is not None  # see WHEN
    return FocalSide(plan.sides)


@dataclasses.dataclass(frozen=True, eq=False)
class FocalSide(Stage):
    """Raises the cost of the levels on the less likely side."""

    sides: FocalSides
    name = "focal side"

    def __call__(self, work: Work) -> None:
        """Add the phase's log-odds of the sides to the cost."""
        volume = self.sides.weigh(work.frame_cost.volume, work.observation, work.grey)
        work.frame_cost = dataclasses.replace(work.frame_cost, volume=volume)
