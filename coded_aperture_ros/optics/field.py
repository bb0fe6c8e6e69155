"""Field curvature: the distance in focus changes away from the middle of the image."""

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

# More than any photographic lens has at 45 degrees, 1/m.
_MAX_DIOPTRES = 1000.0


@dataclasses.dataclass(frozen=True)
class FieldCurvature:
    """Decrease of the inverse focus distance with the angle from the axis.

    ``1 / z_focus`` is lower by ``second t^2 + fourth t^4`` dioptres (1/m), where t is the tangent
    of the angle: positive if the lens is focused farther away there. The blur of thesis eq. 3.28
    falls by M f times that. It is the mean of the radial and the tangential focus.

    Parameters
    ----------
    second, fourth : float, optional
        Dioptres at the tangent 1.

    Raises
    ------
    InputError
        If a coefficient is not finite, or more than a lens can have.

    Examples
    --------
    >>> from coded_aperture_ros.optics import FieldCurvature
    >>> FieldCurvature(0.4).defocus([0.0, 0.25]).tolist()
    [0.0, 0.1]
    """

    second: float = 0.0
    fourth: float = 0.0

    def __post_init__(self) -> None:
        for value in (self.second, self.fourth):
            if not has_type(value, float) or not math.isfinite(value) or abs(value) > _MAX_DIOPTRES:
                raise InputError(
                    f"field_curvature: {value!r} is not a number up to {_MAX_DIOPTRES:g}"
                )

    @classmethod
    def from_entry(cls, entry: Any) -> "FieldCurvature":
        """Field curvature from the entry of a camera file: two numbers."""
        if not isinstance(entry, (list, tuple)) or len(entry) != 2:
            raise InputError(
                f"field_curvature: expected two numbers, as calibrate field gives, got {entry!r}"
            )
        return cls(*entry)

    def defocus(self, squared_tangent: ArrayLike) -> DoubleArray:
        """Decrease of 1 / z_focus in dioptres, for the square of the tangent of the field angle."""
        squared = np.asarray(squared_tangent, np.float64)
        return squared * (self.second + self.fourth * squared)

    def defocus_map(self, intrinsics: Intrinsics, shape: tuple[int, ...]) -> FloatArray:
        """Decrease of 1 / z_focus in dioptres, float32 [rows, columns], over the whole image.

        Distortion is left out: it moves pixels by much less than curvature changes over.
        """
        return _defocus_map(self, intrinsics, shape[0], shape[1])


@lru_cache(maxsize=8)
def _defocus_map(
    curvature: FieldCurvature, intrinsics: Intrinsics, rows: int, columns: int
) -> FloatArray:
    k = intrinsics.resized(columns, rows).camera_matrix
    across = ((np.arange(columns) - k[2]) / k[0]) ** 2
    squared_tangent = across + ((np.arange(rows) - k[5])[:, None] / k[4]) ** 2
    return curvature.defocus(squared_tangent).astype(np.float32)
