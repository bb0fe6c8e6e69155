"""Walks of a coded camera: what it sees, step by step, and from where."""

import dataclasses
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from coded_aperture_benchmarks.datasets.cameras import camera_for_blur
from coded_aperture_benchmarks.datasets.room import random_room, walk
from coded_aperture_benchmarks.datasets.video import load_video, sharp_frames
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.io.messages import luminance
from coded_aperture_ros.optics import Camera, Mask

_FOCAL_LENGTH_PX, _SIZE = 600.0, (480, 640)
# The depths that walks through rooms are made for.
WALKING_RANGE_M = (0.8, 7.0)
_BLUR_PX = (2.0, 16.0)
_EVERY_FRAME = 10_000

# The sharp frame, the true depth, m, and the coded frame without noise.
View = tuple[FloatArray, FloatArray, FloatArray]


@dataclasses.dataclass(frozen=True, eq=False)
class Walk:
    """A way and what is seen on it.

    Attributes
    ----------
    camera : Camera
    range_m : (float, float)
        The depths that it is made for.
    poses : ndarray, float64 [frames, 4, 4], or None
        Where it is, if that is known.
    count : int
        How many frames there are.
    views : iterable of View
        Grey, [rows, columns]; made when asked for.
    """

    camera: Camera
    range_m: tuple[float, float]
    poses: DoubleArray | None
    count: int
    views: Iterable[View]


def walking_camera(mask: Mask) -> Camera:
    """Return the camera of walks through rooms."""
    return camera_for_blur(mask, _FOCAL_LENGTH_PX, _SIZE, WALKING_RANGE_M, _BLUR_PX)


def through_room(seed: int, length_m: float, step_m: float, mask: Mask) -> Walk:
    """Return a walk through a room made by chance, all of it beyond the focus."""
    camera = walking_camera(mask)
    poses = walk(seed, length_m, step_m)

    def views() -> Iterator[View]:
        room = random_room(seed)
        for pose in poses:
            yield *room.seen(camera, pose), room.coded(camera, pose)

    return Walk(camera, WALKING_RANGE_M, poses, len(poses), views())


def of_video(folder: Path, mask_name: str) -> Walk:
    """Return an RGB-D video as a coded camera would have seen it; see `load_video`."""
    video = load_video(folder, _EVERY_FRAME, mask_name)
    range_m = float(np.nanmin(video.depth_m)), float(np.nanmax(video.depth_m))

    def views() -> Iterator[View]:
        # There may be more sharp frames than were read.
        for depth_m, coded, sharp in zip(
            video.depth_m, video.frames, sharp_frames(folder), strict=False
        ):
            yield luminance(sharp), depth_m, luminance(coded)

    return Walk(video.camera, range_m, None, len(video.frames), views())
