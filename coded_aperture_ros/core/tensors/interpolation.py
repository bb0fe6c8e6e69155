"""Linear interpolation for tensors."""

import numpy as np
import torch
from numpy.typing import NDArray

from coded_aperture_ros.core.tensors.constants import kept_on_device


def interpolate(
    at: torch.Tensor, places: NDArray[np.floating], values: NDArray[np.floating | np.integer]
) -> torch.Tensor:
    """Values between places, float32 of the shape of `at`; see ``np.interp``."""
    x, y = (kept_on_device(np.asarray(each, np.float32), at.device) for each in (places, values))
    after = torch.searchsorted(x, at.contiguous()).clip(1, len(x) - 1)
    share = ((at - x[after - 1]) / (x[after] - x[after - 1])).clip(0, 1)
    return torch.lerp(y[after - 1], y[after], share)
