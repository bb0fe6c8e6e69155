"""Types of arrays."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]
DoubleArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]
PerPatch = float | FloatArray  # a number for a whole frame, or one for each patch
Shape = tuple[int, int]  # rows and columns


def as_floats(values: NDArray[Any]) -> FloatArray:
    """Contiguous float32 array of numbers; copied only if they are not one already."""
    return np.ascontiguousarray(values, np.float32)
