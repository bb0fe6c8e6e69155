"""Mean of the frames of a video where nothing moves, which has less noise."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, filters, namespace, quantiles, zeros
from coded_aperture_ros.frames.patches import PatchGrid

# Side of the squares that frames are compared in, px.
_SQUARE_PX = 8
# Blocks along the side of a square.
_BLOCKS = 2
# Standard deviation of the Gaussian around every square, squares.
_SIGMA = 1.0
# Difference beyond the noise that counts as equal, relative to the noise's variance, and the
# further difference that lowers the weight by a factor e.
_TOLERANCE = 0.3
_BANDWIDTH = 0.4
# This share of the squares is taken to be static, if any is.
_STATIC_QUANTILE = 0.2
# Squares that differ by less than this share of the noise's variance are clipped.
_CLIPPED = 0.1


class StaticAverage:
    """Mean of the frames of a video where they differ by noise only.

    It is the temporal part of a non-local mean at one position: a frame ``g_t`` enters the mean
    ``m`` of those before with the weight ``exp(-G * |g_t - m|^2 / tau_1)``. The variance of the
    noise of a mean of ``n`` frames is ``n`` times lower. Motion by a fraction of a pixel exceeds
    the noise and begins a new mean: nothing is smeared.

    Parameters
    ----------
    frames : float
        Largest number of frames in the mean.

    References
    ----------
    Martinello 2012, eq. 8.11.

    Examples
    --------
    >>> average = StaticAverage(4)
    >>> for seed in range(3):
    ...     noise = np.random.default_rng(seed).normal(0, 0.01, (64, 64)).astype(np.float32)
    ...     mean, counts = average.add(0.5 + noise, noise=0.01)
    >>> bool(mean.std() < 0.8 * noise.std()), counts.shape
    (True, (8, 8))
    """

    def __init__(self, frames: float) -> None:
        self._max_frames = max(frames, 1.0)
        self._mean: FloatArray | None = None
        self._count = np.empty((0, 0), np.float32)
        self._difference = self._product = np.empty((0, 0), np.float32)

    def reset(self) -> None:
        """Begin a new mean."""
        self._mean = None

    def add(self, grey: FloatArray, noise: float) -> tuple[FloatArray, FloatArray]:
        """Mean with one more frame, and the number of frames in it.

        Parameters
        ----------
        grey : ndarray, float32 [rows, columns]
        noise : float
            Standard deviation of the noise of one frame, linear light.

        Returns
        -------
        mean : ndarray, float32 [rows, columns]
            Overwritten by the next frame.
        counts : ndarray, float32 [squares down, squares across]
        """
        xp, cv, (height, width) = namespace(grey), filters(grey), grey.shape
        squares = (max(width // _SQUARE_PX, 1), max(height // _SQUARE_PX, 1))
        if self._mean is None:
            self._mean = mean = xp.copy(grey)
            self._difference, self._product = xp.empty_like(grey), xp.empty_like(grey)
            self._count = zeros(squares[::-1], grey) + 1
            return mean, self._count
        difference = cv.subtract(grey, self._mean, self._difference)
        # Means of blocks have less noise, and the same contrast of what moves, which is blurred.
        blocks = cv.resize(
            difference, (_BLOCKS * squares[0], _BLOCKS * squares[1]), interpolation=cv.INTER_AREA
        )
        changed = cv.resize(blocks * blocks, squares, interpolation=cv.INTER_AREA)
        changed = cv.GaussianBlur(changed, (0, 0), _SIGMA) / (1 + 1 / self._count)
        variance = self._variance(changed, (noise * _BLOCKS / _SQUARE_PX) ** 2)
        weight = xp.exp(-xp.maximum(changed / variance - 1 - _TOLERANCE, 0) / _BANDWIDTH)
        self._count = xp.minimum(self._count * weight + 1, self._max_frames)
        shares = cv.resize(1 / self._count, (width, height), self._product)
        cv.accumulateProduct(difference, shares, self._mean)
        return self._mean, self._count

    @staticmethod
    def _variance(changed: FloatArray, known: float) -> FloatArray:
        """Variance of static squares: what is known, or less, where enough squares differ by less.

        A clipped frame has no noise to compare with.
        """
        xp, flat = namespace(changed), changed.ravel()
        noisy = flat > _CLIPPED * known
        (static,) = quantiles(flat, _STATIC_QUANTILE, where=noisy | ~noisy.any())
        variance = xp.where(noisy.any(), xp.minimum(static, known), known)
        return xp.asarray(xp.maximum(variance, 1e-12), dtype=xp.float32)


def frames_per_patch(frames: FloatArray, grid: PatchGrid) -> FloatArray:
    """Number of averaged frames that the noise of every patch corresponds to [rows, columns].

    Examples
    --------
    >>> grid = PatchGrid.covering((64, 64), window_px=32, stride_px=32)
    >>> frames_per_patch(np.full((8, 8), 4, np.float32), grid).tolist()
    [[4.0, 4.0], [4.0, 4.0]]
    """
    side = max(grid.window_px // 2 // _SQUARE_PX, 1)
    share = cv2.blur(1 / frames, (side, side))
    return np.asarray(1 / grid.centre_values(share, _SQUARE_PX), np.float32)


def join_averages(
    forward: tuple[FloatArray, FloatArray],
    backward: tuple[FloatArray, FloatArray],
    grey: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Mean and counts of the frames before and after one.

    Parameters
    ----------
    forward, backward : (ndarray, ndarray)
        Mean and counts up to the frame, and from it on, both with it; see `StaticAverage.add`.
    grey : ndarray, float32 [rows, columns]
        The frame.

    Examples
    --------
    >>> one = np.ones((8, 8), np.float32), np.ones((1, 1), np.float32)
    >>> mean, counts = join_averages(one, one, one[0])
    >>> counts.tolist()
    [[1.0]]
    """
    size = grey.shape[::-1]
    cv = filters(grey)
    before, after = (cv.resize(frames, size) for _, frames in (forward, backward))
    total = before * forward[0] + after * backward[0] - grey
    return total / (before + after - 1), forward[1] + backward[1] - 1
