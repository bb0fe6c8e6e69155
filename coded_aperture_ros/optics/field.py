"""Field curvature: away from the middle of the image a lens is focused at another distance."""

import dataclasses
import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import has_type
from coded_aperture_ros.optics.intrinsics import Intrinsics

_MOST = 1000.0  # than any lens that takes pictures has at 45 degrees


@dataclasses.dataclass(frozen=True)
class FieldCurvature:
    """By how much the inverse distance of the focus falls with the angle from the axis.

    ``1 / z_focus`` is less by ``second t^2 + fourth t^4`` dioptres (1/m), where t is the tangent of
    the angle: positive, if the lens is focused farther away there. So the blur of thesis eq. 3.28
    falls by M f times that. It is the mean of the radial and the tangential focus. An `InputError`
    if they are not finite, or more than a lens can have.
    """

    second: float = 0.0
    fourth: float = 0.0

    def __post_init__(self) -> None:
        for value in (self.second, self.fourth):
            if not has_type(value, float) or not math.isfinite(value) or abs(value) > _MOST:
                raise InputError(f"field_curvature: {value!r} is not a number up to {_MOST:g}")

    @classmethod
    def from_entry(cls, entry: Any) -> "FieldCurvature":
        """Read the entry of a camera file: two numbers."""
        if not isinstance(entry, (list, tuple)) or len(entry) != 2:
            raise InputError(
                f"field_curvature: expected two numbers, as calibrate field gives, got {entry!r}"
            )
        return cls(*entry)

    def defocus(self, tangent2: ArrayLike) -> DoubleArray:
        """Return what is missing of 1 / z_focus where the square of the tangent is `tangent2`."""
        squared = np.asarray(tangent2, np.float64)
        return squared * (self.second + self.fourth * squared)

    def defocus_map(self, intrinsics: Intrinsics, shape: tuple[int, ...]) -> FloatArray:
        """Return what is missing of 1 / z_focus at every pixel of a map of the whole image.

        Distortion is left out: it moves pixels by much less than curvature changes over.
        """
        return _dioptres(self, intrinsics, shape[0], shape[1])


@lru_cache(maxsize=8)
def _dioptres(
    curvature: FieldCurvature, intrinsics: Intrinsics, rows: int, columns: int
) -> FloatArray:
    k = intrinsics.resized(columns, rows).camera_matrix
    across = ((np.arange(columns) - k[2]) / k[0]) ** 2
    tangent2 = across + ((np.arange(rows) - k[5])[:, None] / k[4]) ** 2
    return curvature.defocus(tangent2).astype(np.float32)
