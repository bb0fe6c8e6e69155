"""Depth estimate of one frame."""

import dataclasses
from collections.abc import Callable, Mapping

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.layer import Layer
from coded_aperture_ros.depth.moving import Step
from coded_aperture_ros.depth.quality import Health

# Maps that are NaN where the depth is unknown.
_LEVEL_MAPS = ("level", "blur_size_px", "depth_m", "std_dev_m")


@dataclasses.dataclass(frozen=True, eq=False)
class DepthEstimate:
    """Depth of every pixel of one frame; maps are float32 of one shape [rows, columns].

    Attributes
    ----------
    level : ndarray
        Fractional index into the model's levels; NaN where unknown.
    blur_size_px : ndarray
        Signed blur size in pixels of the frame; NaN where unknown.
    depth_m : ndarray or None
        Depth along the optical axis in metres; NaN where unknown (unless the configuration says
        otherwise), +inf for a level at or beyond the camera's blur size of infinity. None if
        neither the model nor a camera gives the depths of the levels.
    confidence : ndarray
        Probability, in [0, 1], that the depth is right to 5 % (or, without depths, that the level
        is right to one level).
    noise : float
        Standard deviation of the noise of one channel, as estimated or known; without shot noise.
    std_dev_m : ndarray or None
        Standard deviation of `depth_m` in metres; NaN where that is, +inf where that is. None if
        there are no depths.
    health : Health or None
        How well the frame fits the bank; `confidence` includes it. None where it cannot be
        checked: see `unchecked_reason`.
    camera_step : Step or None
        What is known of the camera's motion, with `moving_camera`.
    layers : mapping of str to Layer
        Other results of the stages, by name, such as ``free_space`` or ``motion``.
    stamp_ns : int or None
        Time stamp of the frame, nanoseconds.
    seconds : mapping of str to float
        Time that every stage took, in their order.

    Examples
    --------
    >>> import numpy as np
    >>> depth_m = np.array([[1.0, 2.0]], np.float32)
    >>> confidence = np.array([[0.9, 0.3]], np.float32)
    >>> estimate = DepthEstimate(depth_m, depth_m, depth_m, confidence, noise=0.002)
    >>> estimate.where_confident(0.5).depth_m.tolist()
    [[1.0, nan]]
    """

    level: FloatArray
    blur_size_px: FloatArray
    depth_m: FloatArray | None
    confidence: FloatArray
    noise: float
    std_dev_m: FloatArray | None = None
    health: Health | None = None
    camera_step: Step | None = None
    layers: Mapping[str, Layer] = dataclasses.field(default_factory=dict)
    stamp_ns: int | None = None
    seconds: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def depth_values(self, *, as_levels: bool = False) -> FloatArray:
        """Depth in metres, or, where that is not known or not wanted, levels [rows, columns]."""
        return self.level if as_levels or self.depth_m is None else self.depth_m

    def values(self, layer: str) -> FloatArray | None:
        """Values of a layer, float32 [rows, columns(, 2)]; None if it was not found."""
        return self.layers[layer].values if layer in self.layers else None

    def where_confident(self, threshold: float) -> "DepthEstimate":
        """Estimate with NaN wherever the confidence is below the threshold."""
        return self.without(is_unknown(self.confidence, threshold))

    def without(self, unknown: BoolArray) -> "DepthEstimate":
        """Estimate with NaN where the depth is `unknown` [rows, columns]."""

        def known(values: FloatArray) -> FloatArray:
            values = values.copy()
            np.putmask(values, unknown, np.float32(np.nan))
            return values

        return self._mapped(known, *_LEVEL_MAPS)

    def enlarged(self, size: Shape) -> "DepthEstimate":
        """Estimate with maps of `size` (rows, columns), by nearest neighbours."""
        if self.level.shape == size:
            return self

        def large(values: FloatArray) -> FloatArray:
            # Not linearly: that would make up depths in the air beside every edge.
            return np.asarray(cv2.resize(values, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT))

        layers = {
            name: layer
            if layer.values.shape[:2] == size
            else dataclasses.replace(layer, values=large(layer.values))
            for name, layer in self.layers.items()
        }
        maps = self._mapped(large, *_LEVEL_MAPS, "confidence")
        return dataclasses.replace(maps, layers=layers)

    def _mapped(self, change: Callable[[FloatArray], FloatArray], *names: str) -> "DepthEstimate":
        values = {name: getattr(self, name) for name in names}
        changed = {name: change(value) for name, value in values.items() if value is not None}
        return dataclasses.replace(self, **changed)  # type: ignore[arg-type]


def is_unknown(confidence: FloatArray, threshold: float) -> BoolArray:
    """Where depth is unknown, bool [rows, columns]: less confidence than the threshold, or none.

    With a threshold of 0, that is where the confidence is 0 or NaN.
    """
    return ~(confidence >= threshold if threshold > 0 else confidence > 0)


def check_map_size(size: Shape | None) -> None:
    """Raise `InputError` if a size (rows, columns) is not that of a map."""
    if size is not None and min(size) < 1:
        raise InputError(f"size of the depth map: expected at least 1x1, got {size}")
