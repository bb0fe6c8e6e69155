"""Motion during the exposure, of methods that find it."""

import dataclasses

from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Plan, Stage, Work
from coded_aperture_ros.depth.upsample import MapGrid

MOTION = LayerSpec(
    "motion",
    "Way during the exposure in pixels of the frame, to the right and down.",
    unit="px",
    kind="vector",
    encoding="32FC2",
)
MOTION_CONFIDENCE = LayerSpec(
    "motion/confidence", "Probability that the motion is about right.", unit="", kind="probability"
)
LAYERS: tuple[LayerSpec, ...] = (MOTION, MOTION_CONFIDENCE)
WHEN = "finds_motion"


def make(plan: Plan, config: object) -> Stage:
    """Stage that draws the motion of the patches, if there is any."""
    return Motion()


@dataclasses.dataclass(frozen=True, eq=False)
class Motion(Stage):
    """Draws the motion of the nearest patch at every pixel."""

    name = "motion"

    def __call__(self, work: Work) -> None:
        """Add motion and its confidence, where the likelihood has found some."""
        motion = work.frame_cost.motion
        if motion is None:
            return
        observation = work.observation
        at = MapGrid.for_map(observation.grid, observation.grey.shape, work.size)
        work.add_layer(MOTION, at.nearest_patch_values(motion.vectors_px), motion.search_reason)
        work.add_layer(MOTION_CONFIDENCE, at.nearest_patch_values(motion.confidence))
