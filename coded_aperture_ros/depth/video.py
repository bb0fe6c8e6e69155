"""Depth of a recorded video: each frame with those before and after it."""

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.estimate import DepthEstimate
from coded_aperture_ros.depth.estimator import DepthEstimator
from coded_aperture_ros.depth.stage import Block, Work
from coded_aperture_ros.frames import Frame

# After this many times the length of the memory, a frame no longer counts.
_AHEAD = 2.0
# Frames that are finished together, in units of those that are looked ahead.
_BLOCK = 3


def estimate_video(
    estimator: DepthEstimator, frames: Iterable[Frame | FloatArray], size: Shape | None = None
) -> Iterator[DepthEstimate]:
    """Depth of a video's frames from the past and the future.

    What `DepthEstimator.estimate` does for a camera that runs, with as much of the future as of the
    past: frames are averaged where nothing moves and costs are carried, both ways, and what two
    ways tell of one frame is added up.

    Parameters
    ----------
    estimator : DepthEstimator
        With `DepthConfig.temporal_frames` above 0.
    frames : iterable of Frame or ndarray, float32 [rows, columns] or [rows, columns, 3]
        In order, of one size. A few dozen of them are held at a time.
    size : (int, int), optional
        Rows and columns of the maps; the frames' by default.

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
    estimator.reset()
    ahead = int(np.ceil(_AHEAD * memory))
    remaining = (estimator.begin(frame, size) for frame in frames)
    waiting: list[Work] = []
    while True:
        new = list(islice(remaining, (_BLOCK + 1) * ahead - len(waiting)))
        waiting += new
        if not waiting:
            return
        for work in new:
            check_same_size(work.frame.shape, waiting[0].frame.shape)
        is_last = len(waiting) < (_BLOCK + 1) * ahead
        finished = len(waiting) if is_last else len(waiting) - ahead
        _run_front(estimator, Block(tuple(waiting), len(new), finished))
        done = deque(waiting[:finished])
        waiting = waiting[finished:]
        while done:  # what is done is let go of: it is large
            work = done.popleft()
            estimator.run_back(work)
            yield work.estimate()


def _run_front(estimator: DepthEstimator, block: Block) -> None:
    for stage in estimator.front(block.works[0].frame.shape):
        stage.both_ways(block)


def check_same_size(shape: tuple[int, ...], first: tuple[int, ...]) -> None:
    """Raise `InputError` if a frame of a video has another size than the first."""
    if shape[:2] != first[:2]:
        sizes = [f"{columns}x{rows}" for rows, columns, *_ in (shape, first)]
        raise InputError(f"video: a frame of {sizes[0]} px after frames of {sizes[1]} px")
