"""Grey image, patches and noise of a frame."""

import dataclasses

from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.stage import Block, Plan, Stage, Work
from coded_aperture_ros.likelihood import ChannelLikelihood

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = ""


@dataclasses.dataclass(frozen=True)
class Config:
    """Noise and saturation of the frames."""

    noise: float = option(
        0.0,
        "Standard deviation of one channel's noise, linear light; 0: estimated in each frame.",
        within=(0.0, 0.5),
        parameter="noise.sigma",
        daily=True,
    )
    noise_gain: float = option(
        0.0,
        "Variance of one channel's shot noise per unit of light; adds to the variance of noise.",
        within=(0.0, 0.1),
        parameter="noise.gain",
    )
    least_noise: float = option(
        0.0,
        "The noise is not less than this, whatever a frame looks like: for cameras that compress "
        "their pictures, which hides noise and loses texture. JPEG files and videos say it.",
        within=(0.0, 0.5),
        parameter="noise.least",
    )
    saturation: float = option(
        0.995,
        "Brightness from which a pixel counts as saturated and is left out; above 1: none.",
        within=(0.1, 2.0),
        parameter="frames.saturation",
    )


def make(plan: Plan, config: Config) -> Stage:
    """Stage for frames of the plan's size."""
    return Observe(plan, config.saturation, config.least_noise)


@dataclasses.dataclass(frozen=True, eq=False)
class Observe(Stage):
    """Finds unusable pixels, brightness and noise of a frame."""

    plan: Plan
    saturation: float
    least_noise: float
    name = "observe"

    def __call__(self, work: Work) -> None:
        """Set observation and grey image."""
        plan, frame = self.plan, work.frame
        light = frame.light if work.light is None else work.light
        least_noise = max(self.least_noise, frame.compression_noise)
        work.observation = Observation.from_light(
            light, self.saturation, plan.grid, plan.known_noise, least_noise
        )
        work.grey = work.observation.grey
        if isinstance(plan.likelihood, ChannelLikelihood) and frame.channels > 1:
            work.channels = work.observation.light

    def both_ways(self, block: Block) -> None:
        """Observe the frames that no earlier block had."""
        for work in block.works[len(block.works) - block.new :]:
            self(work)
