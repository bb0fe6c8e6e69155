"""What one frame says about depth."""

import dataclasses
from collections.abc import Callable, Mapping

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.decoders.posterior import is_unsure
from coded_aperture_ros.depth.quality import Health
from coded_aperture_ros.likelihood import MotionField

MAP_SIZES = ("auto", "full", "half", "quarter")
# Best-effort messages larger than such float images are lost with default DDS settings.
_LARGEST_AUTO = (240, 320)
_DIVISORS = {"full": 1, "half": 2, "quarter": 4}
# Maps that are unknown together.
_OF_LEVELS = ("level", "blur_size_px", "depth_m", "std_dev_m")
_BESIDE = ("confidence", "side_confidence", "free_space_m", "second_m", "second_share")


@dataclasses.dataclass(frozen=True, eq=False)
class DepthEstimate:
    """What one frame says about depth; maps are float32 and of one shape [rows, columns].

    Attributes
    ----------
    level : ndarray
        Fractional index into the model's levels; NaN where unknown.
    blur_size_px : ndarray
        Signed blur size in pixels of the frame; NaN where unknown.
    depth_m : ndarray or None
        Depth along the optical axis in metres; NaN where unknown (unless the configuration says
        otherwise), +inf for a level at or beyond the camera's blur size of infinity. None if
        neither a camera nor the model says how far the levels are.
    confidence : ndarray
        Probability, in [0, 1], that the depth is right to 5 % (or, without depths, that the level
        is right to one level).
    noise : float
        Standard deviation of the noise of one channel, as estimated or known; without shot noise.
    side_confidence : ndarray or None
        Probability, in [0, 1], that the level is on the right side of the focal plane; it is part
        of `confidence`. None if the model has levels of one side only.
    std_dev_m : ndarray or None
        Standard deviation of `depth_m` in metres; NaN where that is, +inf where that is. None if
        there are no depths.
    free_space_m : ndarray or None
        What is seen is nearer than this, in metres, in a share of the pixels that the configuration
        says, if frames fit and nothing is nearer than the levels. None if it asks for no bound.
    second_m, second_share : ndarray or None
        Depth of another surface in the window around each pixel, such as what is behind a net, or
        the net, in metres, and the share of the window that it takes, 0 to 1; NaN where there is
        only one. None if the configuration does not ask, or there are no depths.
    motion : MotionField or None
        Motion during the exposure, in maps of the same size; from methods that find it.
    health : Health or None
        How well the frame fits the bank; it is part of `confidence`. None where that cannot be
        told: see `can_be_checked`.
    seconds : mapping of str to float
        How long every stage of the work took, in their order.
    """

    level: FloatArray
    blur_size_px: FloatArray
    depth_m: FloatArray | None
    confidence: FloatArray
    noise: float
    side_confidence: FloatArray | None = None
    std_dev_m: FloatArray | None = None
    free_space_m: FloatArray | None = None
    second_m: FloatArray | None = None
    second_share: FloatArray | None = None
    motion: MotionField | None = None
    health: Health | None = None
    seconds: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def where_confident(self, threshold: float) -> "DepthEstimate":
        """Return the estimate with NaN wherever the confidence is below the threshold."""
        return self.without(is_unsure(self.confidence, threshold))

    def without(self, unknown: BoolArray) -> "DepthEstimate":
        """Return the estimate with NaN in some places [rows, columns]."""

        def known(values: FloatArray) -> FloatArray:
            values = values.copy()
            np.putmask(values, unknown, np.float32(np.nan))
            return values

        return self._mapped(known, *_OF_LEVELS)

    def enlarged(self, size: Shape) -> "DepthEstimate":
        """Return the estimate with maps of `size` (rows, columns), by the nearest pixels."""
        if self.level.shape == size:
            return self

        def large(values: FloatArray) -> FloatArray:
            # Not linearly: that would make up depths in the air beside every edge.
            return np.asarray(cv2.resize(values, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT))

        return self._mapped(large, *_OF_LEVELS, *_BESIDE)

    def _mapped(self, change: Callable[[FloatArray], FloatArray], *names: str) -> "DepthEstimate":
        values = {name: getattr(self, name) for name in names}
        changed = {name: change(value) for name, value in values.items() if value is not None}
        return dataclasses.replace(self, **changed)  # type: ignore[arg-type]


def check_map_size(size: Shape | None) -> None:
    """Refuse a size (rows, columns) that no map can have, by an `InputError`."""
    if size is not None and min(size) < 1:
        raise InputError(f"size of the depth map: expected at least 1x1, got {size}")


def map_size(frame_size: Shape, choice: str) -> Shape:
    """Return the size (rows, columns) of the depth map of frames of a size.

    Sizes are (rows, columns); `choice` is one of `MAP_SIZES`; auto: the largest whole fraction of
    the frame that fits in 320x240.
    """
    rows, columns = frame_size
    fitting = max(-(-rows // _LARGEST_AUTO[0]), -(-columns // _LARGEST_AUTO[1]), 1)
    divisor = _DIVISORS.get(choice, fitting)
    return max(1, rows // divisor), max(1, columns // divisor)
