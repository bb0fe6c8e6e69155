"""Depth as ROS messages hold it (REP 117 and 118)."""

import numpy as np
from numpy.typing import NDArray

# Relative error of a depth computed from a blur size in single precision, generously.
_DEPTH_ROUNDING = 1e-4
_MILLIMETRE = np.float32(1e-3)


def limit_depth(
    depth_m: NDArray[np.float32], near_m: float = 0.0, far_m: float = np.inf
) -> NDArray[np.float32]:
    """Mark known depths outside the range the way REP 117 asks for.

    Returns
    -------
    float32, [row, column]
        Metres; -Inf where nearer than `near_m`, +Inf where farther than `far_m`, NaN where the
        depth is unknown: what is unknown is never called far.
    """
    depth_m = depth_m.astype(np.float32, copy=True)
    # The outermost levels of a bank are the ends of the range but for rounding.
    depth_m[depth_m < near_m * (1 - _DEPTH_ROUNDING)] = -np.inf
    depth_m[depth_m > far_m * (1 + _DEPTH_ROUNDING)] = np.inf
    return depth_m


def millimetres_from_depth(depth_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return depth in whole millimetres, as REP 118 stores it in 16UC1.

    0 stands for everything without a distance: unknown, too near, beyond the range. A distance
    too long for 16 bits saturates at 65535 instead of wrapping, and one below half a millimetre
    becomes 1, because 0 is taken.
    """
    known = np.isfinite(depth_m) & (depth_m > 0)
    # Clipped in metres first: the largest float32 would overflow when multiplied.
    millimetres = np.rint(np.clip(np.where(known, depth_m, 0.0), 0.0, 66.0) * 1000.0)
    return np.where(known, np.clip(millimetres, 1, 65535), 0).astype(np.uint16)


def depth_from_pixels(pixels: NDArray) -> NDArray[np.float32]:
    """Return a depth image of another camera, float32 (m) or uint16 (mm), in metres.

    NaN where the message says nothing: 0, negative, NaN, and infinities, which are no distance.
    """
    depth_m = pixels * _MILLIMETRE if pixels.dtype == np.uint16 else pixels
    known = np.isfinite(depth_m) & (depth_m > 0)
    return np.where(known, depth_m, np.float32(np.nan)).astype(np.float32)
