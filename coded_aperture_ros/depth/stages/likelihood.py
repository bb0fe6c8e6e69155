"""Cost of every level for every patch."""

import dataclasses

from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Plan, Stage, Work
from coded_aperture_ros.likelihood import BACKENDS, Likelihood

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = ""


@dataclasses.dataclass(frozen=True)
class Config:
    """What computes the costs, and where."""

    stride_px: int = option(
        0,
        "Distance between the patches whose depth is estimated; 0: as the bank says, which is 8 "
        "up to a blur of 22 px.",
        unit="px",
        within=(0, 64),
        parameter="compute.stride_px",
    )
    backend: str = option(
        "numpy",
        "What computes costs and networks: torch needs PyTorch, cuda a GPU beside; auto takes the "
        "GPU where there is one.",
        choices=BACKENDS,
        parameter="compute.backend",
    )
    threads: int = option(
        0,
        "Threads of the processor, at most as many as it has cores; 0: all cores, at most 4.",
        within=(0, 1024),
        parameter="compute.threads",
    )


def make(plan: Plan, config: Config) -> Stage:
    """Stage of the plan's likelihood."""
    return CostOfLevels(plan.likelihood)


@dataclasses.dataclass(frozen=True, eq=False)
class CostOfLevels(Stage):
    """Computes the cost of every level, for a frame or a mean of frames that are alike."""

    likelihood: Likelihood
    name = "likelihood"

    def __call__(self, work: Work) -> None:
        """Compute the cost; its parts are timed by themselves."""
        usable, motion = work.observation.usable, work.frame.motion
        cost = self.likelihood.cost(work.measured, work.mean_noise, usable, motion)
        work.frame_cost = cost
        for part, seconds in cost.seconds.items():
            work.seconds[part] = work.seconds.get(part, 0.0) + seconds

    def close(self) -> None:
        """Release the likelihood's threads and memory."""
        self.likelihood.close()
