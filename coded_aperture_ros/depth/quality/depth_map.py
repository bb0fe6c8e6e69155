"""Pictures that are depth maps, in place of frames."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray

# Linear light of a step of 16 and of 8 bits.
_STEP_16 = 1 / 65535
_STEP_8 = 1 / 255
# Share of pixels, of those that are not 0, whose second difference is at most a step of 16 bits:
# 0.7 to 0.85 in depth maps (simulated, estimated, of a Kinect), 0.02 in frames of 16 bits, and at
# most 0.46 in those of a sensor whose noise is a step.
_SMOOTH_SHARE = 0.6
_STEPPED_SHARE = 0.99


def is_as_smooth_as_depth(grey: FloatArray) -> bool:
    """Whether the values of a picture [rows, columns] are those of a depth map, by their noise.

    Pictures of 8 bits are not judged: their smooth parts have steps.
    """
    light = grey[:, 1:-1]
    known = (light > 0) & (grey[:, 2:] > 0) & (grey[:, :-2] > 0)
    if not known.any():
        return False
    steps = light[known] / _STEP_8
    if np.mean(np.abs(steps - np.rint(steps)) < 1e-3) > _STEPPED_SHARE:
        return False
    bend = np.abs(grey[:, 2:] + grey[:, :-2] - 2 * light)[known]
    return bool(np.mean(bend < 1.5 * _STEP_16) > _SMOOTH_SHARE)
