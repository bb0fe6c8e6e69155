"""Poses for the frames of `coded_aperture depth`, from a file or from the bag they are in."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import groupby
from pathlib import Path

from coded_aperture_ros.bags import is_bag
from coded_aperture_ros.bags.poses import BagPoses
from coded_aperture_ros.cli.command import UsageError
from coded_aperture_ros.cli.depth_arguments import Arguments
from coded_aperture_ros.cli.frames import NamedFrame
from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.depth.stages.moving_camera import GYRO
from coded_aperture_ros.frames.pose import Pose
from coded_aperture_ros.io.pose_file import PoseFile

_SECOND_NS = 1e9
# Pose of a frame, by its number in its video.
Poses = Callable[[NamedFrame, int], Pose | DoubleArray | None]


def with_poses(args: Arguments, frames: Iterable[NamedFrame]) -> Iterator[NamedFrame]:
    """Frames, each with its pose.

    Raises
    ------
    InputError
        If the file of poses, or the bag, has none for them.
    """
    check_no_gyroscope(args.estimation)
    of_file = _of_file(PoseFile(args.poses)) if args.poses else None
    for _, video in groupby(frames, key=lambda named: named.video):
        poses = of_file
        for index, named in enumerate(video):
            poses = poses or _of_bag(named.given, args.fixed_frame)
            pose = partial(poses, named, index)
            yield dataclasses.replace(named, frame=dataclasses.replace(named.frame, pose=pose))


def check_no_gyroscope(config: DepthConfig) -> None:
    """Raise a `UsageError` if a gyroscope is wanted, which only nodes listen to."""
    if config.moving_camera == GYRO:
        raise UsageError(
            "--moving-camera gyro: only depth_node listens to a gyroscope, take frames or pose"
        )


def _of_file(file: PoseFile) -> Poses:
    def pose(named: NamedFrame, index: int) -> DoubleArray | None:
        stamp_ns = _stamp_ns(named)
        if stamp_ns is not None:
            return file.at(stamp_ns)
        if index >= len(file):
            raise InputError(
                f"{file.path}: {len(file)} poses, and {named.source} is frame {index + 1}: give a "
                "line for each, or name the pictures by their times in s"
            )
        return file.at(int(file.stamps_ns[index]))

    return pose


def _of_bag(given: str, fixed_frame: str) -> Poses:
    path, _, topic = given.removeprefix("bag:").partition("#")
    if not is_bag(Path(path)):
        raise InputError(
            f"{given}: no bag, so --moving-camera pose needs --poses FILE; or take --moving-camera "
            "frames"
        )
    poses = BagPoses.of_camera(Path(path), fixed_frame, topic or None)

    def pose(named: NamedFrame, index: int) -> Pose | None:
        stamp_ns = _stamp_ns(named)
        return None if stamp_ns is None else poses.at(stamp_ns)

    return pose


def _stamp_ns(named: NamedFrame) -> int | None:
    """Time of a frame by its stamp, or its picture's name, as 12.5.png; None if it has none."""
    capture = named.capture
    if capture is None or capture.stamp_ns:
        return None if capture is None else capture.stamp_ns
    name = capture.name
    try:
        # Without a point it is the picture's number.
        return round(float(name) * _SECOND_NS) if "." in name else None
    except ValueError:
        return None
