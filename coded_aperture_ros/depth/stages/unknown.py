"""Where depth is unknown, and what stands there.

Unknown is what has too little confidence: see `is_unknown`. The decoder gives a confidence, 0 where
all patches around a pixel are dark, saturated or without texture; `quality_of_fit` lowers it where
the frame is not what the model expects, and `periodic_texture` where a pattern repeats. Beyond the
range of the levels depth is infinite, not unknown: see `Levels.metric_maps`.
"""

import dataclasses

from coded_aperture_ros.core.arrays import namespace
from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.estimate import is_unknown
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.stage import Plan, Stage, Work

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = ""
# Of ray-traced pixels whose depth is unknown, what is found with this share is farther than the
# truth by more than 10 % at three in a thousand (47 % without), and by the median at 0.7 of it.
_PLAUSIBLE = 0.05


@dataclasses.dataclass(frozen=True)
class Config:
    """Which depth is unknown."""

    confidence_threshold: float = option(
        0.45,
        "Depth is unknown where the confidence is below this; that of classical regularisation is "
        "at most 0.90.",
        within=(0.0, 1.0),
        parameter="confidence.threshold",
        daily=True,
    )
    unknown: str = option(
        "nothing",
        "What stands where depth is unknown: nothing (NaN), or nearest: the nearest depth that is "
        "plausible, a conservative fill for obstacle avoidance.",
        choices=("nothing", "nearest"),
        parameter="confidence.unknown",
    )


def make(plan: Plan, config: Config) -> Stage:
    """Stage of a threshold."""
    return Unknown(plan.levels, config.confidence_threshold, config.unknown == "nearest")


@dataclasses.dataclass(frozen=True, eq=False)
class Unknown(Stage):
    """Decides where depth is unknown; with `fill_nearest` the nearest plausible stands there."""

    levels: Levels
    threshold: float
    fill_nearest: bool
    name = "unknown"

    def __call__(self, work: Work) -> None:
        """Compare the confidence with the threshold."""
        unknown = is_unknown(work.confidence, self.threshold)
        if self.fill_nearest:
            nearest = self.levels.nearer(work.level, work.decoded.quantile(_PLAUSIBLE))
            xp = namespace(work.level)
            work.level = xp.where(unknown, nearest, work.level)
            unknown = xp.zeros_like(unknown)
        work.unknown = unknown
