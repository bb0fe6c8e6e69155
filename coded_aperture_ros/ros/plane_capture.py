"""Frames of a topic for calibration: the mean of some of them, while the scene stands still."""

import contextlib
import threading
from typing import Any

import numpy as np
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import Gamma, PixelFormat
from coded_aperture_ros.io.messages import MessageError, frame_from_image
from coded_aperture_ros.ros.running import running_apart


class FrameGrabber(contextlib.AbstractContextManager["FrameGrabber"]):
    """Subscribes to a topic of images, and takes means of frames; a context manager.

    Frames are dropped between two pictures: what was seen while the plane was moved does not
    count. `gamma` is that of 8-bit images. An `InputError` says that ROS does not start, or that
    the topic's name is none.
    """

    def __init__(self, topic: str, gamma: Gamma = 1.0) -> None:
        self._topic, self._gamma = topic, gamma
        self._changed = threading.Condition()
        self._frames: list[FloatArray] = []
        self._wanted = 0
        self._refused = ""
        self._running = contextlib.ExitStack()
        try:
            self._running.enter_context(running_apart(self._subscribed, "frames"))
        except Exception as error:  # rclpy's own errors are of many kinds
            raise InputError(f"topic {topic}: {str(error).splitlines()[0]}") from error

    def __exit__(self, *_: object) -> None:
        self._running.close()

    def mean_frame(self, count: int, timeout_s: float) -> FloatArray:
        """Return the mean of the next `count` frames, float32.

        Raises `InputError` if they do not come in time, cannot be used, or change their size
        meanwhile.
        """
        with self._changed:
            self._frames, self._refused, self._wanted = [], "", count
            self._changed.wait_for(lambda: len(self._frames) >= count or self._refused, timeout_s)
            frames, self._frames, self._wanted = self._frames, [], 0
            refused = self._refused
        if refused:
            raise InputError(f"topic {self._topic}: {refused}")
        if len(frames) < count:
            raise InputError(
                f"topic {self._topic}: {len(frames)} of {count} frames came within {timeout_s:g} s"
                + ("" if frames else ": check that a camera publishes there (ros2 topic hz)")
            )
        if len({frame.shape for frame in frames}) > 1:
            raise InputError(f"topic {self._topic}: frames changed their size")
        return np.asarray(np.mean(frames, axis=0, dtype=np.float64), np.float32)

    def _subscribed(self, context: Context) -> Node:
        node = Node("calibrate_planes", context=context)
        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(Image, self._topic, self._receive, qos)
        return node

    def _receive(self, message: Any) -> None:
        with self._changed:
            if len(self._frames) >= self._wanted:
                return
            try:
                frame = frame_from_image(message, PixelFormat(self._gamma))
                self._frames.append(np.array(frame.light))
            except MessageError as error:
                self._refused = str(error)
            self._changed.notify()
