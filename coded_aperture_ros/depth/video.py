"""Depth of a recorded video: each frame with those before and after it."""

from collections.abc import Iterable, Iterator
from itertools import islice, repeat

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.estimate import DepthEstimate, check_map_size
from coded_aperture_ros.depth.estimator import DepthEstimator
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.temporal import TemporalFilter, bounded
from coded_aperture_ros.frames.static_average import StaticAverage, joined
from coded_aperture_ros.likelihood import Cost

# After this many times the length of the memory, a frame no longer counts.
_AHEAD = 2.0
# Frames that are finished together, in units of those that are looked ahead.
_BLOCK = 3


def estimate_video(
    estimator: DepthEstimator,
    frames: Iterable[FloatArray],
    size: Shape | None = None,
    hidden_noise: Iterable[float] = repeat(0.0),
) -> Iterator[DepthEstimate]:
    """Estimate the depth of a video's frames from the past and the future.

    What `DepthEstimator.estimate` does for a camera that runs, with as much of the future as of the
    past: frames are averaged where nothing moves and costs are carried, both ways, and what two
    ways tell of one frame is added up.

    Parameters
    ----------
    estimator : DepthEstimator
        With `DepthConfig.temporal_frames` above 0.
    frames : iterable of ndarray, float32 [rows, columns] or [rows, columns, 3]
        In order, of one size. A few dozen of them are held at a time.
    size : (int, int), optional
        Rows and columns of the maps; the frames' by default.
    hidden_noise : iterable of float, optional
        By compression, one for each frame; see `DepthEstimator.estimate`.

    Yields
    ------
    DepthEstimate
        One for every frame, in order.

    Raises
    ------
    InputError
        If the estimator has no memory, or a frame is refused or of another size.
    """
    memory = estimator.config.temporal_frames
    if not memory:
        raise InputError("temporal_frames: a video with past and future needs more than 0")
    check_map_size(size)
    ahead = int(np.ceil(_AHEAD * memory))
    remaining = map(estimator.observe, frames, hidden_noise)
    forward_mean, forward_cost = StaticAverage(2 * memory), TemporalFilter(memory)
    means: list[tuple[FloatArray, FloatArray]] = []
    waiting: list[Observation] = []
    while True:
        new = list(islice(remaining, (_BLOCK + 1) * ahead - len(waiting)))
        for seen in new:
            check_same_size(seen.grey.shape, (waiting or new)[0].grey.shape)
            mean, frames_of_mean = forward_mean.add(seen.grey, seen.noise.least)
            means.append((mean.copy(), frames_of_mean))
        waiting += new
        if not waiting:
            return
        at_the_end = len(waiting) < (_BLOCK + 1) * ahead
        done = len(waiting) if at_the_end else len(waiting) - ahead
        costs = _costs_both_ways(estimator, waiting, means)
        later = _carried_back(waiting, costs, memory)
        for seen, own, after in zip(waiting[:done], costs, later, strict=False):
            until = forward_cost.add(own.volume, seen.grey, seen.grid, seen.noise.least)
            together = until + after - bounded(own.volume)
            together -= together.min(axis=-1, keepdims=True)
            yield estimator.decide(seen, together, own, size)
        waiting, means = waiting[done:], means[done:]


def _costs_both_ways(
    estimator: DepthEstimator,
    waiting: list[Observation],
    means: list[tuple[FloatArray, FloatArray]],
) -> list[Cost]:
    """Return the cost of every frame, from the mean of what is like it before and after."""
    backward = StaticAverage(2 * estimator.config.temporal_frames)
    costs = []
    for seen, until in zip(reversed(waiting), reversed(means), strict=True):
        grey, frames = joined(until, backward.add(seen.grey, seen.noise.least), seen.grey)
        costs.append(estimator.cost(seen, grey, frames))
    return costs[::-1]


def _carried_back(waiting: list[Observation], costs: list[Cost], memory: float) -> list[FloatArray]:
    """Return the cost of every frame and of those after it."""
    backward = TemporalFilter(memory)
    carried = [
        backward.add(own.volume, seen.grey, seen.grid, seen.noise.least).copy()
        for seen, own in zip(reversed(waiting), reversed(costs), strict=True)
    ]
    return carried[::-1]


def check_same_size(shape: tuple[int, ...], first: tuple[int, ...]) -> None:
    """Refuse a frame of a video of another size than the first, by an `InputError`."""
    if shape[:2] != first[:2]:
        sizes = [f"{columns}x{rows}" for rows, columns, *_ in (shape, first)]
        raise InputError(f"video: a frame of {sizes[0]} px after frames of {sizes[1]} px")
