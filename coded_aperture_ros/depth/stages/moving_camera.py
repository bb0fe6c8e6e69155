"""Past frames of a moving camera, carried along with its motion, and parallax against them."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.moving import Belief, MovingMemory, Pinhole
from coded_aperture_ros.depth.stage import Plan, Stage, Work
from coded_aperture_ros.depth.stages import temporal
from coded_aperture_ros.optics import Camera

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "moving_camera"
FRAMES, POSE = "frames", "pose"
# Larger maps are worked on in so many rows and columns: parallax is found to parts of a pixel.
_LARGEST = (240, 320)
# Where a depth is another than this frame's by more than this share, the edges are the memory's.
_SAME = 0.05


@dataclasses.dataclass(frozen=True)
class Config(temporal.Config):
    """How past frames are used where the camera itself moves."""

    moving_camera: str = option(
        "",
        "What tells how the camera moves, so that past frames help where it does: frames, points "
        "that are found again; pose, the pose that comes with a frame, as from tf, which such "
        "points check; empty: nothing.",
        choices=("", FRAMES, POSE),
        parameter="temporal.moving_camera",
        needs=("temporal_frames", True),
        daily=True,
    )


def make(plan: Plan, config: Config) -> Stage:
    """Stage for the view of the plan's camera.

    Raises
    ------
    InputError
        If depths in metres are not known, or what the camera's view is.
    """
    if plan.camera is None or plan.levels.depths_m is None:
        raise InputError(
            "moving_camera: needs depth in metres and the camera's view: give a camera file"
        )
    return MovingCamera(
        plan.levels, plan.camera, config.temporal_frames, config.moving_camera == POSE
    )


class MovingCamera(Stage):
    """Puts each frame's depth together with what past frames told of the same places."""

    name = "moving camera"

    def __init__(self, levels: Levels, camera: Camera, frames: float, takes_poses: bool) -> None:
        self._levels, self._camera = levels, camera
        # Inverse depth of every level on the axis, 1/m, float64 [L].
        self._table = np.nan_to_num(1 / np.asarray(levels.depths_m), nan=0.0)
        self._frames, self._takes_poses = frames, takes_poses
        self._memory: tuple[Shape, MovingMemory] | None = None

    def __call__(self, work: Work) -> None:
        """Change level, deviation and confidence to those of all frames so far."""
        shape, grey = work.level.shape, work.observation.grey  # not on a device
        size = min(shape[0], _LARGEST[0]), min(shape[1], _LARGEST[1])
        level, deviation, confidence = (
            _resized(values, size) for values in (work.level, work.deviation, work.confidence)
        )
        inverse, per_level = self._inverse(level), self._per_level(level)
        own = Belief(inverse, np.square(deviation * per_level), confidence)
        light = cv2.resize(grey, size[::-1], interpolation=cv2.INTER_AREA)
        asked = work.frame.pose if self._takes_poses else None
        pose = None if asked is None else asked()
        noise = work.observation.noise.typical * (light.size / grey.size) ** 0.5
        step = self._memory_for(size).add(light, own, pose, noise)
        work.camera_step = step
        if step.begun:
            return
        found = step.belief
        change = found.inverse - inverse
        # The inverse depth is linear in the level, but for what the field of the lens adds.
        new_level = self._level(self._axial_inverse(level) + change)
        same = np.abs(change) <= _SAME * np.maximum(found.inverse, inverse)
        # Edges stay where this frame has them, if little else has changed.
        moved = work.level + _resized(new_level - level, shape)
        is_same = _resized(same.astype(np.float32), shape) > 0
        new = np.where(is_same, moved, _resized(new_level, shape))
        work.level = np.asarray(new, np.float32)
        spread = np.asarray(np.sqrt(found.variance) / per_level, np.float32)
        work.deviation = _resized(spread, shape)
        work.confidence = _resized(found.published_confidence, shape)

    def reset(self) -> None:
        """Forget the past frames."""
        self._memory = None

    def _memory_for(self, size: Shape) -> MovingMemory:
        if self._memory is None or self._memory[0] != size:
            view = Pinhole.of_map(self._camera, size)
            self._memory = size, MovingMemory(view, self._frames)
        return self._memory[1]

    def _inverse(self, level: FloatArray) -> FloatArray:
        """Inverse depth of every pixel, 1/m; 0 at infinity."""
        depth_m = self._levels.depth_m(level)
        assert depth_m is not None  # `make` has looked
        return np.asarray(np.nan_to_num(1 / depth_m, nan=0.0), np.float32)

    def _axial_inverse(self, level: FloatArray) -> DoubleArray:
        """The same if all pixels were on the axis."""
        return np.interp(level, np.arange(len(self._table)), self._table)

    def _level(self, axial_inverse: DoubleArray) -> FloatArray:
        """Level of an inverse depth on the axis; the inverse of `_axial_inverse`."""
        order = np.argsort(self._table)
        return np.interp(axial_inverse, self._table[order], order).astype(np.float32)

    def _per_level(self, level: FloatArray) -> FloatArray:
        """Change of the inverse depth from level to level, 1/m, at least a little."""
        slopes = np.abs(np.gradient(self._table)).astype(np.float32)
        slopes = np.maximum(slopes, slopes.max() * np.float32(0.05))
        return np.asarray(slopes.take(np.rint(level).astype(np.intp), mode="clip"))


def _resized(values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Values of the nearest pixels: means would mix what is before an edge and behind it."""
    if values.shape == shape:
        return np.asarray(values, np.float32)
    size = shape[1], shape[0]
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_NEAREST), np.float32)
