"""What a method of deblurring gets, and what it has to do."""

import dataclasses
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.deblur.video import VideoState


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """All that is known of one frame when its blur is to be removed."""

    channels: list[NDArray[np.float32]]  # [rows, columns], see `opponents`; averaged in a video
    frame_count: NDArray[np.float32]  # that they are the mean of [rows, columns] or [1, 1]
    measured: NDArray[np.bool_]  # neither saturated nor impossible [rows, columns]
    blur_size_px: NDArray[np.float32]  # signed, finite; as much smaller as the method asks for
    motion_px: NDArray[np.float32] | None  # [rows, columns, 2]; None if nothing moves
    noise: float  # standard deviation of one channel of one frame


class Method(Protocol):
    """One way to remove the blur.

    Its blur maps are `reduction` times smaller than the frame. `edge_reach` says how far it keeps
    from edges of the depth, relative to the configured reach.
    """

    reduction: int
    edge_reach: float
    removes_motion: bool

    def restore(self, problem: Problem, video: VideoState) -> NDArray[np.float32]:
        """Return the all-in-focus frame [rows, columns] or [rows, columns, 3], not yet clipped.

        A method that iterates begins with what `video` has, and leaves its result there.
        """
