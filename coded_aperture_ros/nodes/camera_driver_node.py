"""The node that brings coded frames into ROS: from a camera, files or the simulator."""

import dataclasses
import math
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from coded_aperture_ros.configuration import check_options, option
from coded_aperture_ros.nodes.camera_model import fitted_camera, required_camera
from coded_aperture_ros.nodes.frame_node import overridable_publisher
from coded_aperture_ros.nodes.messages import (
    MessageError,
    camera_info_from_camera,
    image_from_array,
    pixels_from_frame,
)
from coded_aperture_ros.nodes.parameters import NodeParameters
from coded_aperture_ros.nodes.running import publish, run_nodes
from coded_aperture_ros.nodes.static_transform import broadcast_static, optical_transform
from coded_aperture_ros.sources import SIMULATOR, Capture, open_source

_IDLE_S = 0.05
_RETRY_S = (0.5, 10.0)


@dataclasses.dataclass(frozen=True)
class CameraDriverConfig:
    """Where frames come from and how they are published."""

    source: str = option(
        SIMULATOR,
        "simulator; a camera's index, device or URL; a video, picture or folder of pictures",
        read_only=True,
    )
    camera_file: str = option("", "Camera file (YAML)", read_only=True)
    rate_hz: float = option(
        15.0, "Frames per second", unit="Hz", minimum=0.1, maximum=1000.0, read_only=True
    )
    frame_id: str = option("camera_optical_frame", "Optical frame of the images", read_only=True)
    encoding: str = option(
        "bgr8",
        "Encoding of image_raw",
        choices=("mono8", "rgb8", "bgr8", "mono16"),
        read_only=True,
    )
    loop: bool = option(True, "Begin files again after their last frame", read_only=True)
    noise: float = option(
        0.002,
        "Standard deviation of the simulated sensor's noise in linear light",
        minimum=0.0,
        maximum=0.5,
        read_only=True,
    )
    lazy: bool = option(True, "Simulate, or read files, only while someone subscribes")
    base_frame: str = option(
        "", "Publish the static transform from this frame to frame_id; empty: none", read_only=True
    )
    base_x_m: float = option(0.0, "Camera position in base_frame", unit="m", read_only=True)
    base_y_m: float = option(0.0, "Camera position in base_frame", unit="m", read_only=True)
    base_z_m: float = option(0.0, "Camera position in base_frame", unit="m", read_only=True)
    base_pitch_deg: float = option(
        0.0,
        "How far the camera looks down",
        unit="degrees",
        minimum=-180.0,
        maximum=180.0,
        read_only=True,
    )

    def __post_init__(self) -> None:
        check_options(self)


class CameraDriverNode(Node):
    """Publishes frames and their camera model, in a thread of its own.

    The thread keeps time by a steady clock, so that it also runs where the ROS clock stands
    still; the stamps are those of the ROS clock when a frame has been acquired.
    """

    def __init__(self, **node_options: Any) -> None:
        super().__init__("camera_driver_node", **node_options)
        self.configs = NodeParameters(self, CameraDriverConfig())
        config = self._config
        self._camera = required_camera(config.camera_file)
        self._source = open_source(
            config.source, self._camera, config.rate_hz, loop=config.loop, noise=config.noise
        )
        topics: dict[str, type] = {"image_raw": Image, "camera_info": CameraInfo}
        if config.source == SIMULATOR:
            topics.update({"ground_truth/depth": Image, "ground_truth/image": Image})
        self._outputs = {
            topic: overridable_publisher(self, message_type, topic)
            for topic, message_type in topics.items()
        }
        if config.base_frame:
            broadcast_static(
                self,
                optical_transform(
                    config.base_frame,
                    config.frame_id,
                    (config.base_x_m, config.base_y_m, config.base_z_m),
                    math.radians(config.base_pitch_deg),
                ),
            )
        self._warned_of_size = False
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self.get_name(), daemon=True)
        self._thread.start()

    @property
    def _config(self) -> CameraDriverConfig:
        return self.configs[CameraDriverConfig]

    def close(self) -> None:
        """End the thread; the node can then be destroyed."""
        self._stopping.set()
        self._thread.join(5.0)

    def _wants(self, topic: str) -> bool:
        return topic in self._outputs and self._outputs[topic].get_subscription_count() > 0

    def _idle(self) -> bool:
        # A live source goes on, or the first frame to be published would be an old one.
        if self._source.live or not self._config.lazy:
            return False
        return not any(self._wants(topic) for topic in self._outputs)

    @property
    def _going_on(self) -> str:
        return "trying again until it works" if self._source.live else "going on with what follows"

    def _run(self) -> None:
        retry_s, due_s = _RETRY_S[0], time.monotonic()
        while not self._stopping.is_set():
            if self._idle():
                self._stopping.wait(_IDLE_S)
                due_s = time.monotonic()
                continue
            try:
                if not self._publish_next():
                    self.get_logger().info(f"end of {self._config.source}")
                    break
            except Exception as error:
                # A camera that is unplugged, or a driver that fails in its own way: the robot
                # goes on, and so does this node as soon as there are frames again.
                if retry_s == _RETRY_S[0]:
                    self.get_logger().error(f"{error}; {self._going_on}")
                self._stopping.wait(retry_s)
                retry_s = min(2 * retry_s, _RETRY_S[1])
                continue
            if retry_s != _RETRY_S[0]:
                retry_s = _RETRY_S[0]
                self.get_logger().info("frames are coming again")
            if not self._source.live:
                due_s = max(due_s + 1.0 / self._config.rate_hz, time.monotonic())
                self._stopping.wait(due_s - time.monotonic())
        self._source.close()

    def _publish_next(self) -> bool:
        """Acquire and publish a frame; False at the end of the source."""
        capture = self._source.read()
        if capture is None:
            return False
        stamp = self.get_clock().now().to_msg()
        self._publish(capture, Header(frame_id=self._config.frame_id, stamp=stamp))
        return True

    def _publish(self, capture: Capture, header: Header) -> None:
        encoding = self._config.encoding
        pixels = pixels_from_frame(capture.frame, encoding)
        image = image_from_array(pixels, encoding, header)
        publish(self, self._outputs["image_raw"], image)
        self._publish_camera_info(image.width, image.height, header)
        if capture.depth_m is not None and self._wants("ground_truth/depth"):
            depth = image_from_array(capture.depth_m, "32FC1", header)
            publish(self, self._outputs["ground_truth/depth"], depth)
        if capture.sharp is not None and self._wants("ground_truth/image"):
            sharp = image_from_array(pixels_from_frame(capture.sharp, encoding), encoding, header)
            publish(self, self._outputs["ground_truth/image"], sharp)

    def _publish_camera_info(self, width: int, height: int, header: Header) -> None:
        try:
            info = camera_info_from_camera(fitted_camera(self._camera, width, height), header)
        except MessageError as error:
            if not self._warned_of_size:
                self._warned_of_size = True
                self.get_logger().warning(f"no camera_info: {error}")
            return
        publish(self, self._outputs["camera_info"], info)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is told to stop; return the exit status."""
    return run_nodes([CameraDriverNode], args)


if __name__ == "__main__":
    sys.exit(main())
