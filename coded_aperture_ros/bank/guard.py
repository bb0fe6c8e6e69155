"""Levels beyond a depth range, which take in what is not in it."""

import numpy as np

from coded_aperture_ros.optics import Camera


def guarded_range(
    camera: Camera, near_m: float, far_m: float, level_count: int
) -> tuple[float, float, int]:
    """Return a depth range with one more level on either side, and its number of levels.

    What is too near or beyond the range is the most like one of these levels. Without them it
    would be taken, with full confidence, for something at the end of the range.

    Raises
    ------
    InputError
        If the range does not suit the camera.
    """
    ends = np.array(camera.blur_range_px(near_m, far_m))
    step = (ends[1] - ends[0]) / (level_count - 1)
    beyond = np.array([ends[0] - step, ends[1] + step])
    # At most half of the way to the plane in focus or to infinity.
    focus_end = np.argmin(np.abs(ends))
    nearer_focus = abs(beyond[focus_end]) < abs(ends[focus_end]) / 2
    if ends[0] * ends[1] > 0 and (nearer_focus or beyond[focus_end] * ends[0] < 0):
        beyond[focus_end] = ends[focus_end] / 2
    beyond[1] = min(beyond[1], (ends[1] + camera.blur_at_infinity_px) / 2)
    nearest_m, farthest_m = camera.depth_m(beyond)
    return float(nearest_m), float(farthest_m), level_count + 2
