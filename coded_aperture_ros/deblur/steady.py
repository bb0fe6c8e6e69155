"""Less noise in the all-in-focus frames of a video: what stays alike is averaged first."""

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.imaging import StillAverage


class SteadyFrames:
    """Averages the coded frames of a video, along non-local weights in time, before deblurring.

    The thesis proposes such weights for depth (eq. 8.11) and leaves all-in-focus frames for later.
    Averaged coded frames have less noise, so that the filters may be sharper; averaged
    all-in-focus frames would only be less noisy. What moves by a fraction of a pixel starts anew
    and is deblurred as a single frame.

    Parameters
    ----------
    frames : float
        Frames that are averaged at most, > 0.
    """

    def __init__(self, frames: float) -> None:
        self._frames = frames
        self._averages: list[StillAverage] = []
        self._shape: tuple[int, ...] = ()
        self._restored: list[NDArray[np.float32]] | None = None

    def reset(self) -> None:
        """Forget the frames so far."""
        self._averages, self._restored = [], None

    def add(
        self, channels: list[NDArray[np.float32]], noise: float
    ) -> tuple[list[NDArray[np.float32]], NDArray[np.float32]]:
        """Return the mean with one more frame, and how many frames it is of.

        Parameters
        ----------
        channels : list of ndarray, float32 [rows, columns]
            Another number or size of channels than before begins another video.
        noise : float
            Standard deviation of one frame's noise.

        Returns
        -------
        channels : list of ndarray, float32 [rows, columns]
        frames : ndarray, float32 [rows, columns]
            Of the channel that changed most; at least 1.
        """
        shape = (len(channels), *channels[0].shape)
        if shape != self._shape:
            self.reset()
            self._shape = shape
        if not self._averages:
            self._averages = [StillAverage(self._frames) for _ in channels]
        means = [
            average.add(channel, noise)
            for average, channel in zip(self._averages, channels, strict=True)
        ]
        least = np.min([count for _, count in means], axis=0)
        frames = cv2.resize(least, shape[:0:-1], interpolation=cv2.INTER_LINEAR)
        return [mean.copy() for mean, _ in means], np.asarray(frames, np.float32)

    def start(
        self, closed_form: list[NDArray[np.float32]], frames: NDArray[np.float32]
    ) -> list[NDArray[np.float32]]:
        """Return where to begin to restore: the last result wherever nothing has changed."""
        if self._restored is None:
            return closed_form
        still = frames > 1.5
        return [
            np.where(still, last, fresh)
            for last, fresh in zip(self._restored, closed_form, strict=True)
        ]

    def keep(self, restored: list[NDArray[np.float32]]) -> None:
        """Remember a result, to begin with it next time."""
        self._restored = restored
