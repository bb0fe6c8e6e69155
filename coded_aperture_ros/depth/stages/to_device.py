"""Copy of a frame on the device that computes its depth."""

import dataclasses

from coded_aperture_ros.core.arrays import Uploads
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Plan, Stage, Work

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "costs_on_device"


def make(plan: Plan, config: object) -> Stage:
    """Stage for the plan's device."""
    from coded_aperture_ros.core.tensors.transfer import upload_to

    assert plan.device is not None  # see WHEN
    return ToDevice(upload_to(plan.device))


@dataclasses.dataclass(frozen=True, eq=False)
class ToDevice(Stage):
    """Copies to the device what costs and levels are computed from."""

    upload: Uploads
    name = "to device"

    def __call__(self, work: Work) -> None:
        """Replace the grey image, and what the next stages see, by tensors."""
        seen = work.observation
        grey = self.upload(seen.grey)
        light = grey if seen.light is seen.grey else self.upload(seen.light)
        unusable = None if seen.unusable is None else self.upload(seen.unusable)
        work.seen = dataclasses.replace(
            seen, light=light, grey=grey, usable=self.upload(seen.usable), unusable=unusable
        )
        work.grey = grey if work.grey is seen.grey else self.upload(work.grey)
