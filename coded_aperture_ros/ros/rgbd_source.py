"""Coded frames rendered from the RGB-D topics of any simulator, camera or bag."""

import threading
from functools import partial

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import Image

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.messages import (
    MessageError,
    depth_from_pixels,
    depth_pixels,
    frame_from_image,
)
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.ros.messages import stamp_ns as stamp_of
from coded_aperture_ros.ros.pairing import StampPairs
from coded_aperture_ros.ros.topics import Inputs
from coded_aperture_ros.simulation import SensorModel, render_coded_frame
from coded_aperture_ros.sources import Capture

RGBD = "rgbd"
_IMAGE = "rgbd/image"
_DEPTH = "rgbd/depth"
# Messages of each topic that wait for their partner.
_WAITING_MESSAGES = 10
# A pair that takes longer is reported as missing.
_PAIR_TIMEOUT_S = 1.0


class RgbdSource:
    """Source of coded frames, rendered from pairs of an image and its depth.

    It subscribes to `rgbd/image`, of a linear sensor, and `rgbd/depth` (32FC1 in metres or 16UC1 in
    millimetres), of one size and with equal stamps. Only the newest pair is kept.

    Parameters
    ----------
    node : Node
    camera : Camera
        Its focal length has to be that of the images.
    sensor : SensorModel
        Of the simulated sensor.
    """

    live = True

    def __init__(self, node: Node, camera: Camera, sensor: SensorModel) -> None:
        self._camera = camera
        self._sensor = sensor
        self._random = np.random.default_rng(0)
        self._pairs: StampPairs[Image, Image] = StampPairs(_WAITING_MESSAGES, lambda: None)
        self._changed = threading.Condition()
        self._pair: tuple[Image, Image] | None = None
        self._inputs = Inputs(node, None)
        self._inputs.add(_IMAGE, Image, partial(self._receive, True))
        self._inputs.add(_DEPTH, Image, partial(self._receive, False))
        self._inputs.open()

    def read(self) -> Capture | None:
        """Coded frame of the next pair; an `InputError` if none comes or it cannot be used."""
        with self._changed:
            self._changed.wait_for(lambda: self._pair is not None, _PAIR_TIMEOUT_S)
            pair, self._pair = self._pair, None
        if pair is None:
            raise InputError(
                f"no pair of {_IMAGE} and {_DEPTH} with equal stamps within {_PAIR_TIMEOUT_S:g} s"
            )
        sharp = frame_from_image(pair[0]).light
        depth_m = depth_in_metres(pair[1])
        if sharp.shape[:2] != depth_m.shape:
            raise MessageError("size", f"{_IMAGE} and {_DEPTH} are not of one size")
        coded = render_coded_frame(sharp, depth_m, self._camera)
        coded = self._sensor.expose(coded, self._random)
        return Capture(coded, depth_m, sharp, stamp_of(pair[0].header))

    def close(self) -> None:
        """Drop the messages that have come."""
        self._pairs.clear()
        with self._changed:
            self._pair = None

    def end(self) -> None:
        """End the subscriptions; only while no executor waits for the node."""
        self._inputs.close()

    def _receive(self, first: bool, message: Image) -> None:
        pair = self._pairs.add(first, stamp_of(message.header), message)
        if pair is not None:
            with self._changed:
                self._pair = pair
                self._changed.notify()


def depth_in_metres(message: Image) -> FloatArray:
    """Depth map of a depth image (REP 118), m, NaN where unknown; float32 [rows, columns].

    Raises
    ------
    MessageError
        If it is not a depth image, or no depth is known in it.
    """
    depth_m = depth_from_pixels(depth_pixels(message))
    if not np.isfinite(depth_m).any():
        raise MessageError("depth", "no depth is known in the whole image")
    return depth_m
