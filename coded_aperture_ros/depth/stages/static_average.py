"""Noise reduction where nothing moves: mean of the equal frames of a video."""

from coded_aperture_ros.core.arrays import FloatArray, in_memory, namespace
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.stage import Block, Plan, Stage, Work
from coded_aperture_ros.depth.stages import temporal
from coded_aperture_ros.frames import StaticAverage, join_averages

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "temporal_frames"
# Frames that are averaged at most, in units of the frames that the video's memory is long.
_LENGTH = 2


def make(plan: Plan, config: temporal.Config) -> Stage:
    """Stage of a video's frames."""
    return StaticAveraging(_LENGTH * config.temporal_frames)


class StaticAveraging(Stage):
    """Takes the mean of the frames so far, and of later ones where they are known."""

    name = "static average"

    def __init__(self, most_frames: float) -> None:
        self._most_frames = most_frames
        self._before = StaticAverage(most_frames)
        # Means of the frames up to each of those that wait for the frames after them.
        self._waiting: list[tuple[FloatArray, FloatArray]] = []

    def __call__(self, work: Work) -> None:
        """Put the mean of the frames so far in the place of the frame."""
        observation = work.observation
        work.grey, count = self._before.add(observation.grey, observation.noise.least)
        work.averaged_frames = in_memory(count)

    def both_ways(self, block: Block) -> None:
        """Put the mean of the frames before and after each in its place."""
        for work in block.works[len(block.works) - block.new :]:
            observation = work.observation
            mean, count = self._before.add(observation.grey, observation.noise.least)
            self._waiting.append((namespace(mean).copy(mean), count))
        after = StaticAverage(self._most_frames)
        for work, before in zip(reversed(block.works), reversed(self._waiting), strict=True):
            observation = work.observation
            backward = after.add(observation.grey, observation.noise.least)
            work.grey, count = join_averages(before, backward, observation.grey)
            work.averaged_frames = in_memory(count)
        self._waiting = self._waiting[block.finished :]

    def reset(self) -> None:
        """Forget the past frames."""
        self._before.reset()
        self._waiting = []
