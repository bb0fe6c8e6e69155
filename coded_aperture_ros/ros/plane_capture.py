"""Mean frames of a topic, for calibration with planes."""

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
from coded_aperture_ros.ros.running import node_in_thread


class FrameGrabber(contextlib.AbstractContextManager["FrameGrabber"]):
    """Subscribes to a topic of images and averages frames; a context manager.

    Frames between two calls of `mean_frame` are dropped: the plane may have been moved then.

    Parameters
    ----------
    topic : str
    gamma : float or "srgb"
        Of 8-bit images.

    Raises
    ------
    InputError
        If ROS does not start, or the name of the topic is not valid.
    """

    def __init__(self, topic: str, gamma: Gamma = 1.0) -> None:
        self._topic = topic
        self._gamma = gamma
        self._changed = threading.Condition()
        self._frames: list[FloatArray] = []
        self._wanted = 0
        self._refused = ""
        self._running = contextlib.ExitStack()
        try:
            self._running.enter_context(node_in_thread(self._subscribed_node, "frames"))
        except Exception as error:  # rclpy's own errors are of many kinds
            raise InputError(f"topic {topic}: {str(error).splitlines()[0]}") from error

    def __exit__(self, *_: object) -> None:
        self._running.close()

    def mean_frame(self, count: int, timeout_s: float) -> FloatArray:
        """Mean of the next `count` frames, linear light, float32 [rows, columns(, 3)].

        Raises
        ------
        InputError
            If they do not come in time, cannot be used, or change their size meanwhile.
        """
        with self._changed:
            self._frames = []
            self._refused = ""
            self._wanted = count
            self._changed.wait_for(lambda: len(self._frames) >= count or self._refused, timeout_s)
            frames = self._frames
            refused = self._refused
            self._frames = []
            self._wanted = 0
        if refused:
            raise InputError(f"topic {self._topic}: {refused}")
        if len(frames) < count:
            raise InputError(
                f"topic {self._topic}: {len(frames)} of {count} frames came within {timeout_s:g} s"
                + ("" if frames else ": check that a camera publishes there (ros2 topic hz)")
            )
        if len({frame.shape for frame in frames}) > 1:
            raise InputError(f"topic {self._topic}: frames changed their size: try again")
        return np.asarray(np.mean(frames, axis=0, dtype=np.float64), np.float32)

    def _subscribed_node(self, context: Context) -> Node:
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
