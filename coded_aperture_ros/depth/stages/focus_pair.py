"""A second frame of the same view, with the lens focused elsewhere."""

import dataclasses

from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Plan, SecondFocus, Stage, Work

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "second_focus"


def make(plan: Plan, config: object) -> Stage:
    """Stage of pairs of frames."""
    assert plan.second_focus is not None  # see WHEN
    return AddSecondFocus(plan.second_focus)


@dataclasses.dataclass(frozen=True, eq=False)
class AddSecondFocus(Stage):
    """Adds the cost of the same depths by the second frame, and how well that fits its bank."""

    second: SecondFocus
    name = "focus pair"

    def __call__(self, work: Work) -> None:
        """Add the cost of the second frame, if there is one."""
        if work.frame.refocused is not None:
            work.frame_cost, work.health = self.second.add(work.frame_cost, work.frame.refocused)

    def close(self) -> None:
        """Release the threads for the second frame."""
        self.second.close()
