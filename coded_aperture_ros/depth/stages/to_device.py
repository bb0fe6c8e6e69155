"""Copy of a frame on the device that computes its depth."""

import dataclasses

from coded_aperture_ros.core.arrays import Uploads, as_floats
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Block, Plan, Stage, Work

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "costs_on_device"


def make(plan: Plan, config: object) -> Stage:
    """Stage for the plan's device."""
    from coded_aperture_ros.core.tensors.transfer import upload_to

    assert plan.device is not None  # see WHEN
    return ToDevice(upload_to(plan.device))


@dataclasses.dataclass(frozen=True, eq=False)
class ToDevice(Stage):
    """Copies the light of frames to the device, where all else is computed from it."""

    upload: Uploads
    name = "to device"

    def __call__(self, work: Work) -> None:
        """Set the light to a tensor."""
        work.light = self.upload(as_floats(work.frame.light))

    def both_ways(self, block: Block) -> None:
        """Copy the frames that no earlier block had."""
        for work in block.works[len(block.works) - block.new :]:
            self(work)
