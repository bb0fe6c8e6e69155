"""From levels to blur sizes and metres."""

import dataclasses

from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.stage import Plan, Stage, Work

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = ""


def make(plan: Plan, config: object) -> Stage:
    """Stage of the plan's levels."""
    return Metric(plan.levels)


@dataclasses.dataclass(frozen=True, eq=False)
class Metric(Stage):
    """Looks up blur size, depth and its standard deviation; NaN where the depth is unknown."""

    levels: Levels
    name = "metric"

    def __call__(self, work: Work) -> None:
        """Replace levels that are unknown, and set blur size, depth and standard deviation."""
        maps = self.levels.metric_maps(work.level, work.deviation, work.unknown)
        work.level, work.blur_size_px, work.depth_m, work.std_dev_m = maps
