"""High-pass channels of a frame (thesis eq. 5.2)."""

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray

# Differences to the right, downward, and along the two diagonals; P = 2 in the thesis.
_DIFFERENCES = (
    np.array([[-1.0, 1.0]]),
    np.array([[-1.0], [1.0]]),
    np.array([[-1.0, 0.0], [0.0, 1.0]]),
    np.array([[0.0, -1.0], [1.0, 0.0]]),
)
# Directions (row, column) that are nearer to an axis than this have the other axis across them.
_NEARLY_AXIS = np.tan(np.pi / 8)


def channel_kernel(
    channel: int, direction: NDArray[np.floating] | None = None, smoothing: int = 0
) -> FloatArray:
    """Return the kernel [k, k], odd k, of a derivative that is smoothed across a direction.

    Smoothing across a line leaves what is on it as it is, but for the noise: the texture that the
    blur has left changes slowly from line to line. To be correlated, as by ``cv2.filter2D``.

    `channel` is 0 to 3: the difference to the right, downward, or along a diagonal. The direction
    [2] is (row, column). Neighbours across it are averaged `smoothing` times, an even number.
    """
    kernel = _DIFFERENCES[channel]
    if direction is not None and smoothing:
        weights = np.ones(1)
        for _ in range(smoothing):
            weights = np.convolve(weights, [0.5, 0.5])
        down, right = (float(part) for part in direction)
        if abs(down) <= _NEARLY_AXIS * abs(right):
            across = weights[:, None]
        elif abs(right) <= _NEARLY_AXIS * abs(down):
            across = weights[None, :]
        else:
            across = np.diag(weights)
            if down * right > 0:
                across = across[:, ::-1]
        wider = np.pad(kernel, [(side // 2, side // 2) for side in across.shape])
        kernel = scipy.ndimage.convolve(wider, across, mode="constant")
    side = max(kernel.shape) // 2 * 2 + 1
    odd = np.zeros((side, side), np.float32)
    odd[: kernel.shape[0], : kernel.shape[1]] = kernel
    return odd
