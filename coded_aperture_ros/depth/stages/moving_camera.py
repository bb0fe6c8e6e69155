"""Past frames of a moving camera, carried along with its motion, and parallax against them."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import option
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.moving import Belief, MovingMemory, Pinhole, Step
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
        self._frames, self._takes_poses = frames, takes_poses
        self._memory: tuple[Shape, MovingMemory] | None = None

    def __call__(self, work: Work) -> None:
        """Change level, deviation and confidence to those of all frames so far."""
        shape = work.level.shape
        size = min(shape[0], _LARGEST[0]), min(shape[1], _LARGEST[1])
        own_inverse = self._inverse(work.level)
        per_level = self._per_level(work.level)
        belief = Belief(
            _sampled(own_inverse, size),
            _sampled(np.square(work.deviation * per_level), size),
            _sampled(work.confidence, size),
        )
        light = cv2.resize(work.grey, size[::-1], interpolation=cv2.INTER_AREA)
        asked = work.frame.pose if self._takes_poses else None
        step = self._memory_for(size).add(light, belief, None if asked is None else asked())
        work.camera_step = step
        if not step.begun:
            self._set(work, belief, step, own_inverse, per_level)

    def reset(self) -> None:
        """Forget the past frames."""
        self._memory = None

    def _memory_for(self, size: Shape) -> MovingMemory:
        if self._memory is None or self._memory[0] != size:
            view = Pinhole.of_map(self._camera, size)
            self._memory = size, MovingMemory(view, self._frames)
        return self._memory[1]

    def _set(
        self, work: Work, own: Belief, step: Step, own_inverse: FloatArray, per_level: FloatArray
    ) -> None:
        """Write what was found into the maps, whose edges stay where little has changed."""
        shape, found = work.level.shape, step.belief
        change, inverse, variance, confidence = (
            _enlarged(values, shape)
            for values in (
                found.inverse - own.inverse,
                found.inverse,
                found.variance,
                found.published_confidence,
            )
        )
        same = np.abs(change) <= _SAME * np.maximum(inverse, own_inverse)
        inverse = np.asarray(np.where(same, own_inverse + change, inverse), np.float32)
        # The inverse depth is linear in the level, but for what the field of the lens adds.
        tables = self._tables
        axial = np.interp(work.level, np.arange(len(tables)), tables) + inverse - own_inverse
        order = np.argsort(tables)
        level = np.interp(axial, tables[order], order.astype(np.float64))
        work.level = np.asarray(level, np.float32)
        deviation = np.sqrt(variance) / np.maximum(per_level, np.float32(1e-6))
        work.deviation = np.asarray(deviation, np.float32)
        work.confidence = confidence

    def _inverse(self, level: FloatArray) -> FloatArray:
        """Inverse depth of every pixel, 1/m; 0 at infinity."""
        depth_m = self._levels.depth_m(level)
        assert depth_m is not None  # `make` has looked
        return np.asarray(np.nan_to_num(1 / depth_m, nan=0.0), np.float32)

    def _per_level(self, level: FloatArray) -> FloatArray:
        """Change of the inverse depth from level to level, 1/m, at least a little."""
        tables = self._tables
        slopes = np.abs(np.gradient(tables)).astype(np.float32)
        slopes = np.maximum(slopes, slopes.max() * np.float32(0.05))
        return np.asarray(slopes.take(np.rint(level).astype(np.intp), mode="clip"))

    @property
    def _tables(self) -> DoubleArray:
        """Inverse depth of every level on the axis, 1/m, float64 [L]."""
        depths_m = self._levels.depths_m
        assert depths_m is not None  # `make` has looked
        return np.nan_to_num(1 / depths_m, nan=0.0)


def _sampled(values: FloatArray, size: Shape) -> FloatArray:
    """Values of every second pixel, or so: means would mix what is before an edge and behind it."""
    if values.shape == size:
        return np.asarray(values, np.float32)
    sampled: FloatArray = cv2.resize(
        np.asarray(values, np.float32), size[::-1], interpolation=cv2.INTER_NEAREST
    )
    return sampled


def _enlarged(values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    return _sampled(values, (shape[0], shape[1]))
