"""Free-space bound: a distance that the scene is nearer than only at a stated risk."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, namespace
from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.decoders.regularize import LEARNED
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.moving.clearance import clearance_m
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
# Factor and exponent of the risk that give the quantile of the blur size for the bound. Fitted so
# that, on the least favourable kind of random scenes and mask, no more pixels are nearer.
_SHARE = 1.2
_POWER = 0.7


@dataclasses.dataclass(frozen=True)
class Config:
    """Risk of the bound."""

    free_space_risk: float = option(
        0.0,
        "Give a bound that such a share of the pixels may be nearer than: 0.001 to 0.01; 0: none.",
        within=(0.0, 0.1),
        needs=("regularize", LEARNED),
        parameter="free_space.risk",
        daily=True,
    )


def make(plan: Plan, config: Config) -> Stage:
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
        xp = namespace(work.level)
        bound = xp.full_like(work.level, float(self.levels.nearest_first[0]))
        nearest = work.decoded.nearest_around(_SHARE * self.risk**_POWER)
        if nearest is not None:
            bound = xp.where(work.doubted, bound, self.levels.nearer(work.level, nearest))
        bound_m = self.levels.depth_m(bound)
        if bound_m is not None:
            work.add_layer(FREE_SPACE, self._with_past(work, bound_m))

    def _with_past(self, work: Work, bound_m: FloatArray) -> FloatArray:
        """Bound, as much farther as the frames of a moving camera have shown it to be free."""
        step, depth_m = work.camera_step, self.levels.depth_m(work.level)
        if step is None or step.begun or depth_m is None:
            return bound_m
        clear_m = clearance_m(step.belief)
        clear_m = cv2.resize(clear_m, bound_m.shape[::-1], interpolation=cv2.INTER_NEAREST)
        clear_m = np.maximum(bound_m, np.minimum(clear_m, depth_m))
        return np.asarray(np.where(work.doubted, bound_m, clear_m), np.float32)
