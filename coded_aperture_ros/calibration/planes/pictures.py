"""Pictures of textured planes at known depths."""

import dataclasses
import itertools

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError

_MIN_PLANES = 4
_SATURATED = 0.995
_MAX_SATURATED_SHARE = 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class Planes:
    """Pictures of textured planes parallel to the sensor, one for each depth.

    Raises
    ------
    InputError
        If there are fewer than four planes, sizes differ, a depth is not positive, not the only one
        of its value or out of order, or a picture is saturated or not finite.
    """

    # [rows, columns] or [rows, columns, 3]; linear light in [0, 1], all of one size.
    images: tuple[FloatArray, ...]
    # [I]; depth of each plane, nearest first; where they come farthest first, they are turned
    # round.
    depths_m: DoubleArray
    names: tuple[str, ...]  # what to call each picture in messages

    def __post_init__(self) -> None:
        depths = np.asarray(self.depths_m, np.float64)
        if not len(self.images) == len(depths) == len(self.names):
            raise InputError("planes: expected one depth and one name for each picture")
        if len(depths) < _MIN_PLANES:
            raise InputError(
                f"{len(depths)} planes are too few to tell the mask from the textures: "
                f"take at least {_MIN_PLANES}, better 10 or more, at different depths"
            )
        for image, depth, name in zip(self.images, depths, self.names, strict=True):
            if not 0 < depth < np.inf:
                raise InputError(f"{name}: depth_m {depth:g} is not a positive distance in metres")
            check_picture(image, name, self.images[0].shape[:2], self.names[0])
        for first, second in itertools.pairwise(np.argsort(depths, kind="stable")):
            if depths[first] == depths[second]:
                raise InputError(
                    f"{self.names[second]}: depth_m {depths[second]:g} is also that of "
                    f"{self.names[first]}: keep one picture for each depth"
                )
        order = np.arange(len(depths))
        if depths[0] > depths[-1]:
            order = order[::-1]
        for nearer, farther in itertools.pairwise(order):
            # A depth out of order is more often mistyped than not sorted.
            if depths[nearer] > depths[farther]:
                raise InputError(
                    f"{self.names[farther]}: depth_m {depths[farther]:g} is out of order beside "
                    f"{depths[nearer]:g} of {self.names[nearer]}: correct it, or list the planes "
                    "from the nearest to the farthest"
                )
        object.__setattr__(self, "images", tuple(self.images[i] for i in order))
        object.__setattr__(self, "names", tuple(self.names[i] for i in order))
        object.__setattr__(self, "depths_m", depths[order])


def check_picture(image: FloatArray, name: str, shape: tuple[int, ...], first: str) -> None:
    """Raise `InputError` for a picture of another `shape`, not finite, or saturated.

    Messages call the picture `name`, and the one with that shape `first`.
    """
    if image.shape[:2] != shape:
        raise InputError(
            f"{name}: {image.shape[1]}x{image.shape[0]} px, but {first} has "
            f"{shape[1]}x{shape[0]} px: all planes have to come from one camera"
        )
    if not np.isfinite(image).all():
        raise InputError(f"{name}: has pixels that are NaN or infinite")
    saturated = float(np.mean(image >= _SATURATED))
    if saturated > _MAX_SATURATED_SHARE:
        raise InputError(
            f"{name}: {saturated:.0%} of the pixels are saturated: expose it for a shorter time"
        )
