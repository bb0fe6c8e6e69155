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

# Frames of look-ahead, in units of the memory's length: later ones have no weight left.
_AHEAD = 2.0
# Frames that are finished together, in units of the look-ahead.
_BLOCK = 3


def estimate_video(
    estimator: DepthEstimator, frames: Iterable[Frame | FloatArray], size: Shape | None = None
) -> Iterator[DepthEstimate]:
    """Depth of every frame of a recorded video, from the frames before and after it.

    Like `DepthEstimator.estimate` for live frames, but non-causal: where nothing moves, frames are
    averaged in both directions, and the costs of both directions are added up.

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
        If the estimator has no memory, or a frame is invalid or of another size.

    References
    ----------
    Martinello 2012, eq. 8.11 (weights between frames).

    Examples
    --------
    >>> import numpy as np
    >>> from coded_aperture_ros.depth.config import DepthConfig
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("levin"), np.linspace(2, 9, 15)))
    >>> estimator = DepthEstimator(bank, DepthConfig(temporal_frames=1, regularize="none"))
    >>> frames = np.random.default_rng(0).random((3, 64, 96), np.float32)
    >>> [estimate.level.shape for estimate in estimate_video(estimator, frames)]
    [(64, 96), (64, 96), (64, 96)]
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
        while done:  # finished frames are released at once: they are large
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
