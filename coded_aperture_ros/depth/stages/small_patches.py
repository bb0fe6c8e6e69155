"""Cost of small patches, which see edges more sharply."""

import dataclasses

from coded_aperture_ros.depth.decoders.network import small_cost
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Plan, Stage, Work
from coded_aperture_ros.likelihood import Likelihood

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "small"


def make(plan: Plan, config: object) -> Stage:
    """Stage of the small patches that the network needs."""
    assert plan.small is not None  # see WHEN
    return SmallPatches(plan.small)


@dataclasses.dataclass(frozen=True, eq=False)
class SmallPatches(Stage):
    """Computes the cost of every blur size for the small patches."""

    likelihood: Likelihood
    name = "small patches"

    def __call__(self, work: Work) -> None:
        """Add the cost of the small patches to that of the frame."""
        small = small_cost(self.likelihood, work.observation, work.measured, work.mean_noise)
        work.frame_cost = dataclasses.replace(work.frame_cost, small=small)

    def close(self) -> None:
        """Release the likelihood's threads and memory."""
        self.likelihood.close()
