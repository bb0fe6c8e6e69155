"""Poses of a bag's camera, from /tf, /tf_static and odometry."""

import dataclasses
import math
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

from coded_aperture_ros.bags.codec import read_message, read_picture
from coded_aperture_ros.bags.contents import Topic
from coded_aperture_ros.bags.reading import Bag
from coded_aperture_ros.bags.topics import image_topic
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames.pose import Pose
from coded_aperture_ros.io.messages import MessageError, Transforms

TF, TF_STATIC = "/tf", "/tf_static"
TF_TYPE, ODOMETRY_TYPE = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
_INSTEAD = "or --moving-camera frames, which needs no poses"


@dataclasses.dataclass(frozen=True, eq=False)
class BagPoses:
    """Poses of a frame of the robot in another, from a bag.

    Attributes
    ----------
    path : Path
        Of the bag.
    fixed_frame : str
    frame : str
        Of the camera, as its messages name it.
    """

    path: Path
    fixed_frame: str
    frame: str

    @classmethod
    def of_camera(cls, path: Path, fixed_frame: str, topic: str | None = None) -> "BagPoses":
        """Poses of the camera of a topic, by default of the only images.

        Raises
        ------
        InputError
            If the bag has no poses of it.
        """
        with Bag(path) as bag:
            images = image_topic(bag.topics, topic)
            poses = cls(path, fixed_frame, _frame_of(bag, images))
            poses._check(bag)
        return poses

    def at(self, stamp_ns: int) -> Pose | None:
        """Pose of the camera at a stamp, ns, as `Frame.pose` has it; None if unknown."""
        return self._transforms.located(self.fixed_frame, self.frame, stamp_ns)

    @cached_property
    def _transforms(self) -> Transforms:
        with Bag(self.path) as bag:
            return _read(bag)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_transforms"}

    def _check(self, bag: Bag) -> None:
        """Raise an `InputError` if there are no poses; keep those that there are."""
        if not any(topic.type_name in (TF_TYPE, ODOMETRY_TYPE) for topic in bag.topics.values()):
            raise InputError(
                f"{self.path}: no poses: expected {TF} and {TF_STATIC}, or nav_msgs/Odometry, "
                f"{_INSTEAD}"
            )
        transforms = vars(self)["_transforms"] = _read(bag)
        if not transforms.connects(self.fixed_frame, self.frame):
            raise InputError(
                f"{self.path}: no transform from {self.frame or 'the camera without a frame_id'} "
                f"to {self.fixed_frame}, the bag has {', '.join(transforms.frames) or 'none'}: "
                f"give --fixed-frame, {_INSTEAD}"
            )


def _frame_of(bag: Bag, topic: Topic) -> str:
    """Name of the frame of a topic's first image that can be read."""
    for message in bag.messages(topic.name):
        try:
            return str(read_picture(message.data, topic.type_name).header.frame_id)
        except MessageError:
            continue
    raise InputError(f"{bag.path}: no frame of {topic.name} could be used")


def _read(bag: Bag) -> Transforms:
    """All transforms of a bag; those of odometry only for frames that /tf does not have."""
    by_tf, by_odometry = Transforms(math.inf), Transforms(math.inf)
    types = {
        name: topic.type_name
        for name, topic in bag.topics.items()
        if topic.type_name in (TF_TYPE, ODOMETRY_TYPE)
    }
    for message in bag.messages(*types) if types else ():
        kind = types[message.topic]
        static = message.topic.endswith(TF_STATIC)
        receive = by_tf.receive_static if static else by_tf.receive
        with suppress(MessageError):  # what is damaged tells nothing
            content = read_message(message.data, kind)
            (by_odometry.receive_odometry if kind == ODOMETRY_TYPE else receive)(content)
    by_tf.add_missing(by_odometry)
    return by_tf
