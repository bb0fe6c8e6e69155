"""Free-space bound: a distance that what is seen is nearer than at a stated risk only."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.decoders.regularize import LEARNED
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.stage import Plan, Stage, Work

FREE_SPACE = LayerSpec(
    "free_space",
    "What is seen is farther than this, but for the stated share of the pixels, if frames fit and "
    "nothing is nearer than the levels.",
    unit="m",
    kind="bound",
    points="free_points",
    title="free up to, at a risk",
)
LAYERS: tuple[LayerSpec, ...] = (FREE_SPACE,)
WHEN = "free_space_risk"
# This share of the probability of the blur sizes, times a power of the risk, lies before the bound:
# on random scenes of the kind and with the mask that it suits least no more pixels are nearer.
_SHARE = 1.2
_POWER = 0.7


@dataclasses.dataclass(frozen=True)
class FreeSpaceConfig:
    """Risk of the bound."""

    free_space_risk: float = option(
        0.0,
        "Give a bound that such a share of the pixels may be nearer than: 0.001 to 0.01; 0: none.",
        within=(0.0, 0.1),
        needs=("regularize", LEARNED),
        parameter="free_space.risk",
        daily=True,
    )


def make(plan: Plan, config: FreeSpaceConfig) -> Stage:
    """Stage of a bound at the risk that is asked for."""
    return FreeSpace(plan.levels, config.free_space_risk)


@dataclasses.dataclass(frozen=True, eq=False)
class FreeSpace(Stage):
    """Finds the bound of every pixel; nothing is free where the frame is doubted."""

    levels: Levels
    risk: float
    name = "free space"

    def __call__(self, work: Work) -> None:
        """Add the bound."""
        bound = np.full_like(work.level, self.levels.nearest_first[0])
        found = work.decoded.nearest_around(_SHARE * self.risk**_POWER)
        if found is not None:
            bound = np.where(work.doubted, bound, self.levels.nearer(work.level, found))
        bound_m = self.levels.depth_m(bound)
        if bound_m is not None:
            work.add_layer(FREE_SPACE, bound_m)
