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
    """Lets levels of the less likely side cost more."""

    sides: FocalSides
    name = "focal side"

    def __call__(self, work: Work) -> None:
        """Weigh the cost of the levels by what the phase says."""
        volume = self.sides.weigh(work.frame_cost.volume, work.observation, work.grey)
        work.frame_cost = dataclasses.replace(work.frame_cost, volume=volume)
