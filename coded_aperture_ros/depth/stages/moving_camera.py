"""Past frames of a moving camera, carried along with its motion, and parallax against them."""

import dataclasses

import cv2

from coded_aperture_ros.core.arrays import Shape, in_memory
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import option
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.moving import MovingMemory, Pinhole
from coded_aperture_ros.depth.moving.outcome import Translation
from coded_aperture_ros.depth.stage import Plan, Stage, Work
from coded_aperture_ros.depth.stages import temporal
from coded_aperture_ros.depth.stages.from_device import fetch_maps
from coded_aperture_ros.optics import Camera

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = "moving_camera"
FRAMES, GYRO, POSE = "frames", "gyro", "pose"
# Larger maps are worked on in so many rows and columns: parallax is found to parts of a pixel.
_LARGEST = (240, 320)


@dataclasses.dataclass(frozen=True)
class Config(temporal.Config):
    """How past frames are used where the camera itself moves."""

    moving_camera: str = option(
        "",
        "What tells how the camera moves, so that past frames help where it does: frames, points "
        "that are found again; gyro, the same, with turns from a gyroscope; pose, the pose that "
        "comes with a frame, as from tf, which such points check; empty: nothing.",
        choices=("", FRAMES, GYRO, POSE),
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
    takes_poses = config.moving_camera in (GYRO, POSE)
    return MovingCamera(plan.levels, plan.camera, config.temporal_frames, takes_poses, plan.workers)


class MovingCamera(Stage):
    """Puts each frame's depth together with what past frames told of the same places."""

    name = "moving camera"

    def __init__(
        self,
        levels: Levels,
        camera: Camera,
        frames: float,
        takes_poses: bool,
        workers: Workers | None = None,
    ) -> None:
        self._translation, self._camera = Translation(levels), camera
        self._frames, self._takes_poses, self._workers = frames, takes_poses, workers
        self._memory: tuple[Shape, MovingMemory] | None = None

    def __call__(self, work: Work) -> None:
        """Change level, deviation and confidence to those of all frames so far."""
        fetch_maps(work)
        if fetch := getattr(work.decoded, "in_memory", None):
            work.decoded = fetch()
        shape, grey = work.level.shape, in_memory(work.observation.grey)
        size = min(shape[0], _LARGEST[0]), min(shape[1], _LARGEST[1])
        small = self._translation.belief((work.level, work.deviation, work.confidence), size)
        light = cv2.resize(grey, size[::-1], interpolation=cv2.INTER_AREA)
        asked = work.frame.pose if self._takes_poses else None
        pose = None if asked is None else asked()
        noise = work.observation.noise.typical * (light.size / grey.size) ** 0.5
        step = self._memory_for(size).add(light, small[1], pose, noise)
        work.camera_step = step
        if step.begun:
            return
        work.level, work.deviation, work.confidence = self._translation.maps(
            work.level, small, step.belief
        )

    def reset(self) -> None:
        """Forget the past frames."""
        self._memory = None

    def _memory_for(self, size: Shape) -> MovingMemory:
        if self._memory is None or self._memory[0] != size:
            view = Pinhole.of_map(self._camera, size)
            self._memory = size, MovingMemory(view, self._frames, self._workers)
        return self._memory[1]
