"""The interface of the stages that a frame goes through."""

import dataclasses
import time
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.plan import Plan
from coded_aperture_ros.depth.work import Work


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """Frames of a recorded video that are worked on together, in order.

    Attributes
    ----------
    works : sequence of Work
        All of them; the last ones were seen only for the sake of those before.
    new : int
        Number of those at the end that no block before this one had.
    finished : int
        Number of those at the beginning that leave with this block.
    """

    works: Sequence[Work]
    new: int
    finished: int


class Stage:
    """One step of the work on a frame; the stages of a plan are called in order.

    A stage that remembers frames of a video overrides `reset`, and `both_ways` for recorded
    videos, whose frames it knows before and after each.
    """

    name: str  # of its time in diagnostics and JSON

    def __call__(self, work: Work) -> None:
        """Read what is there, add what is found."""
        raise NotImplementedError

    def both_ways(self, block: Block) -> None:
        """Do the same for every frame of a block, with regard to those before and after it."""
        for work in block.works:
            self(work)

    def reset(self) -> None:
        """Forget the frames so far: the next one begins another video."""

    def close(self) -> None:
        """Let go of threads and memory of devices."""


class StageModule(Protocol):
    """What the file of a stage defines."""

    LAYERS: tuple[LayerSpec, ...]  # what the stage may add
    # Option, or attribute of the plan, without which there is no such stage; empty: always.
    WHEN: str

    def make(self, plan: Plan, config: Any) -> Stage:
        """Stage for frames of one size.

        `config` is a `DepthConfig`; the stage reads the fields of its own configuration.
        """


def run(stages: Iterable[Stage], work: Work) -> None:
    """Call stages in order, and note how long each took.

    Times of its parts that a stage has noted itself are not counted a second time.
    """
    for stage in stages:
        began_s, noted_s = time.perf_counter(), sum(work.seconds.values())
        stage(work)
        took_s = time.perf_counter() - began_s - (sum(work.seconds.values()) - noted_s)
        work.seconds[stage.name] = work.seconds.get(stage.name, 0.0) + took_s
