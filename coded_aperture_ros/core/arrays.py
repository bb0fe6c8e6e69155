"""Short names for the arrays of which nearly everything here is made."""

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
    """Return numbers as float32, row by row in memory; they are copied only where they are not."""
    return np.ascontiguousarray(values, np.float32)
