"""Less noise where nothing moves: the mean of the frames of a video at places that stay alike."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.frames.patches import PatchGrid

# Frames are compared by blocks, so many along the side of a square, and a Gaussian around every
# square, in squares.
_SQUARE_PX = 8
_BLOCKS = 2
_SIGMA = 1.0
# The share of the noise's variance by which two frames may differ and are surely alike, and the
# share beyond that makes it e times less likely.
_ALIKE = 0.3
_BANDWIDTH = 0.4
# This share of the squares is taken to be static, if any is.
_STATIC_QUANTILE = 0.2
# Squares that differ by less than this share of the noise's variance are clipped.
_CLIPPED = 0.1


class StaticAverage:
    """Averages the frames of a video, at most so many, where they are alike but for their noise.

    It is the temporal part of a non-local mean (thesis eq. 8.11) at one place: a frame ``g_t``
    enters the mean ``m`` of those before by ``exp(-G * |g_t - m|^2 / tau_1)``. A mean of ``n``
    frames has ``n`` times less noise, and blur sizes differ by what is above the noise.
    Whatever moves by a fraction of a pixel is beyond the noise and starts anew: it does not smear.
    """

    def __init__(self, frames: float) -> None:
        self._most = max(frames, 1.0)
        self._mean: FloatArray | None = None
        self._count = np.empty((0, 0), np.float32)
        self._difference = self._product = np.empty((0, 0), np.float32)

    def reset(self) -> None:
        """Forget the past."""
        self._mean = None

    def add(self, grey: FloatArray, noise: float) -> tuple[FloatArray, FloatArray]:
        """Return the mean with one more frame, and how many frames it is of.

        `noise` is the standard deviation of one frame's. The mean is valid until the next frame is
        added; the numbers of frames are float32 [squares down, squares across].
        """
        height, width = grey.shape
        squares = (max(width // _SQUARE_PX, 1), max(height // _SQUARE_PX, 1))
        if self._mean is None:
            self._mean = grey.copy()
            self._difference, self._product = np.empty_like(grey), np.empty_like(grey)
            self._count = np.ones(squares[::-1], np.float32)
            return self._mean, self._count
        difference = cv2.subtract(grey, self._mean, self._difference)
        # Means of blocks have less noise, but as much of what moves: it is blurred.
        blocks = cv2.resize(
            difference, (_BLOCKS * squares[0], _BLOCKS * squares[1]), interpolation=cv2.INTER_AREA
        )
        changed = cv2.resize(blocks * blocks, squares, interpolation=cv2.INTER_AREA)
        changed = cv2.GaussianBlur(changed, (0, 0), _SIGMA) / (1 + 1 / self._count)
        variance = (noise * _BLOCKS / _SQUARE_PX) ** 2
        # Where a frame is clipped there is no noise to compare with.
        noisy = changed[changed > _CLIPPED * variance]
        if noisy.size:
            variance = min(variance, float(np.quantile(noisy, _STATIC_QUANTILE)))
        variance = max(variance, 1e-12)
        alike = np.exp(-np.maximum(changed / variance - 1 - _ALIKE, 0) / _BANDWIDTH)
        self._count = np.minimum(self._count * alike + 1, np.float32(self._most))
        shares = cv2.resize(1 / self._count, (width, height), self._product)
        cv2.accumulateProduct(difference, shares, self._mean)
        return self._mean, self._count


def frames_per_patch(frames: FloatArray, grid: PatchGrid) -> FloatArray:
    """Return how many frames the mean is of, as every patch's noise has it [rows, columns]."""
    side = max(grid.window_px // 2 // _SQUARE_PX, 1)
    share = cv2.blur(1 / frames, (side, side))
    return np.asarray(1 / grid.centre_values(share, _SQUARE_PX), np.float32)


def join_averages(
    forward: tuple[FloatArray, FloatArray],
    backward: tuple[FloatArray, FloatArray],
    grey: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Join the means of the frames up to one and from it on, both with it, and their counts."""
    size = grey.shape[::-1]
    before, after = (cv2.resize(frames, size) for _, frames in (forward, backward))
    total = before * forward[0] + after * backward[0] - grey
    return total / (before + after - 1), forward[1] + backward[1] - 1
