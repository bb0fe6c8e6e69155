"""Node that publishes coded frames of a camera, of files or of the simulator."""

import math
import threading
import time
from typing import Any

from numpy.typing import NDArray
from rclpy.publisher import Publisher
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.share import demo_camera_file
from coded_aperture_ros.frames import PixelFormat
from coded_aperture_ros.io.messages import compressed_picture, pixels_from_frame
from coded_aperture_ros.ros.camera_driver_config import CameraDriverConfig, LazyConfig
from coded_aperture_ros.ros.camera_info_store import CameraInfoStore
from coded_aperture_ros.ros.camera_model import required_camera
from coded_aperture_ros.ros.diagnostics import (
    DiagnosticsConfig,
    DiagnosticsPublisher,
    Statistics,
    camera_name,
)
from coded_aperture_ros.ros.managed_node import LONGEST_FRAME_S, ManagedNode
from coded_aperture_ros.ros.messages import (
    camera_info_from_camera,
    camera_info_from_recorded,
    compressed_message,
    image_from_array,
)
from coded_aperture_ros.ros.rgbd_source import RGBD, RgbdSource
from coded_aperture_ros.ros.scheduling import Pace
from coded_aperture_ros.ros.static_transform import broadcast_static, optical_transform
from coded_aperture_ros.ros.topics import LocalTopics, Outputs
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.simulation.exposure import sensor_of_camera_file
from coded_aperture_ros.sources import (
    SIMULATOR,
    Capture,
    DeviceConfig,
    DeviceSource,
    Source,
    open_source,
)

# Time between two checks for a subscriber.
_IDLE_S = 0.05
# Pause after a failure of the source: the first, and the longest; each is twice the one before.
_FIRST_RETRY_S = 0.5
_LONGEST_RETRY_S = 10.0
# Shortest time between two log lines about missing RGB-D pairs, or about camera_info.
_LOG_PERIOD_S = 10.0


# Topics that the node publishes, and their message types.
OUTPUT_TYPES: dict[str, type] = {
    "image_raw": Image,
    "image_raw/compressed": CompressedImage,
    "camera_info": CameraInfo,
}
# Those of simulated frames.
TRUTH_TYPES: dict[str, type] = {
    "ground_truth/depth": Image,
    "ground_truth/image": Image,
    "ground_truth/camera_info": CameraInfo,
}


class CameraDriverNode(ManagedNode):
    """Publishes frames and their camera model, from a thread of its own.

    The thread is timed by a steady clock, so that it also runs where the ROS clock stands still.
    Stamps are those of the source, or else the ROS time when a frame has been acquired.
    """

    def __init__(self, *, local: LocalTopics | None = None, **node_options: Any) -> None:
        super().__init__(
            "camera_driver_node",
            LazyConfig(),
            DeviceConfig(),
            DiagnosticsConfig(),
            fixed={"": CameraDriverConfig()},
            shares_arguments=local is not None,
            **node_options,
        )
        config = self._config
        self.statistics = Statistics()
        topics = dict(OUTPUT_TYPES)
        if config.source in (SIMULATOR, RGBD):
            topics |= TRUTH_TYPES
        if config.publish_clock:
            topics["/clock"] = ClockMessage
        self._outputs = Outputs(self, topics, local)
        self._name = config.camera_name or camera_name(self)
        self._source: Source | None = None
        self._store: CameraInfoStore | None = None
        self._diagnostics: DiagnosticsPublisher | None = None
        self._static_publisher: Publisher | None = None
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()  # ends the thread
        self._failures = 0
        self._failing = False
        self.begin()

    @property
    def _config(self) -> CameraDriverConfig:
        return self.configs[CameraDriverConfig]

    @property
    def _camera_file(self) -> str:
        """Camera file; the demo's, if none is given and the camera is simulated."""
        config = self._config
        if config.camera_file or config.source != SIMULATOR:
            return config.camera_file
        return str(demo_camera_file())

    def _sensor(self) -> SensorModel:
        """Noise of the simulated sensor."""
        if self._config.noise >= 0:
            return SensorModel(self._config.noise)
        return sensor_of_camera_file(self._camera_file, self._camera)

    def set_up(self) -> None:
        """Load the camera file and open the source."""
        config = self._config
        self._camera = required_camera(self._camera_file)
        if config.source == RGBD:
            self._source = RgbdSource(self, self._camera, self._sensor())
        else:
            self._source = open_source(
                config.source,
                self._camera,
                config.rate_hz,
                loop=config.loop,
                sensor=self._sensor() if config.source == SIMULATOR else None,
                device=self.configs[DeviceConfig],
            )
        self._store = CameraInfoStore(self, config.camera_info_url, self._name)
        self._outputs.open()
        if config.base_frame:
            self._static_publisher = broadcast_static(
                self,
                optical_transform(
                    config.base_frame,
                    config.frame_id,
                    (config.base_x_m, config.base_y_m, config.base_z_m),
                    math.radians(config.base_pitch_deg),
                ),
            )
        self._diagnostics = DiagnosticsPublisher(self, self.statistics, self._describe)

    def clean_up(self) -> None:
        """Undo `set_up`."""
        if isinstance(self._source, RgbdSource):
            self._source.end()
        for made in (self._diagnostics, self._store, self._source):
            if made is not None:
                made.close()
        self._diagnostics = None
        self._store = None
        self._source = None
        if self._static_publisher is not None:
            self.destroy_publisher(self._static_publisher)
            self._static_publisher = None
        self._outputs.close()

    def start_work(self) -> None:
        """Start the thread that publishes frames."""
        if self._thread is not None and self._thread.is_alive():
            raise InputError(
                f"{self._config.source}: still reading a frame from before: wait, and try again"
            )
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self.get_name(), daemon=True)
        self._thread.start()
        topic = self.resolve_topic_name("image_raw")
        when = ", once somebody subscribes" if self.configs[LazyConfig].lazy else ""
        self.get_logger().info(f"frames of {self._config.source} go to {topic}{when}")

    def stop_work(self) -> None:
        """End the thread, which closes the source, as soon as the frame in work is done."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(LONGEST_FRAME_S)

    def _run(self) -> None:
        source = self._source
        assert source is not None  # it was set up
        try:
            self._take_frames(source, self._stopping)
        finally:
            source.close()

    def _take_frames(self, source: Source, stopping: threading.Event) -> None:
        pace = Pace(stopping)
        retry_s = _FIRST_RETRY_S
        settings = self.configs[DeviceConfig]
        while not stopping.is_set():
            # A live source is read all the same: the first frame published would be an old one.
            lazy = self.configs[LazyConfig].lazy and not source.live
            if lazy and not self._outputs.listened():
                stopping.wait(_IDLE_S)
                pace.begin()
                continue
            try:
                if isinstance(source, DeviceSource):
                    settings = self._configure_device(source, settings)
                read_s = time.monotonic()
                capture = source.read()
                # Reading a live source is waiting for the camera; reading another one is work.
                work_s = 0.0 if source.live else time.monotonic() - read_s
                if capture is None:
                    self.get_logger().info(f"{self._config.source}: end of file")
                    break
                self.statistics.count_received()
                if not source.live:
                    pace.wait(1.0 / self._config.rate_hz, capture.stamp_ns)
                publish_s = time.monotonic()
                self._publish(capture)
                self.statistics.count_processed(None, work_s + time.monotonic() - publish_s)
            except Exception as error:
                # An unplugged camera, or any error of its driver: the robot keeps driving, and the
                # node publishes again as soon as there are frames.
                # RGB-D pairs may fail many times a second: their log lines are throttled. Reading
                # them has waited already, and a pause would delay the next pair.
                pairs = isinstance(source, RgbdSource)
                self._report_failure(source, error, _LOG_PERIOD_S if pairs else 0.0)
                if not pairs:
                    stopping.wait(retry_s)
                    retry_s = min(2 * retry_s, _LONGEST_RETRY_S)
                continue
            if self._failing:
                self._failing = False
                retry_s = _FIRST_RETRY_S
                self.get_logger().info("frames arrive again")

    def _report_failure(self, source: Source, error: Exception, log_period_s: float) -> None:
        """Count a failure of the source; log the first one of a series."""
        self.statistics.count_rejected("source", str(error))
        if not self._failing:
            self._failing = True
            self._failures += 1
            next_step = "retrying until it works" if source.live else "skipped, reading the next"
            self.get_logger().error(f"{error}; {next_step}", throttle_duration_sec=log_period_s)

    def _configure_device(self, source: DeviceSource, settings: DeviceConfig) -> DeviceConfig:
        """Set changed parameters on the device; warn of those that it refuses.

        Returns the present settings; `settings` are those that the device has.
        """
        present = self.configs[DeviceConfig]
        if present is not settings:
            source.configure(present)
        if source.refused:
            self.get_logger().warning(f"the device refuses: {', '.join(source.refused)}")
            source.refused = ()
        if source.automatic:
            self.get_logger().warning(
                f"the device adjusts its {' and '.join(source.automatic)} automatically: depth "
                "needs a fixed focus and exposure, set them (device.exposure)"
            )
            source.automatic = ()
        return present

    def _publish(self, capture: Capture) -> None:
        """Publish a frame, its camera model and its ground truth."""
        stamp_ns = capture.stamp_ns
        publishes_clock = self._config.publish_clock
        if stamp_ns is None:  # the ROS time would wait for the /clock that this node publishes
            stamp_ns = time.time_ns() if publishes_clock else self.get_clock().now().nanoseconds
        stamp = Time(nanoseconds=stamp_ns).to_msg()
        header = Header(frame_id=self._config.frame_id, stamp=stamp)
        encoding = self._config.encoding
        frame = capture.frame
        if capture.mosaic:
            frame = PixelFormat(mosaic=capture.mosaic).picture(frame)
        if publishes_clock:
            self._outputs.send("/clock", ClockMessage(clock=header.stamp))
        info = self._camera_info(capture, header)
        if info is not None:  # before its frame
            self._outputs.send("camera_info", info)
        self._publish_picture(frame, header)
        if capture.depth_m is None:
            return
        if info is not None:
            self._outputs.send("ground_truth/camera_info", info)
        if self._outputs.listened("ground_truth/depth"):
            depth = image_from_array(capture.depth_m, "32FC1", header)
            self._outputs.send("ground_truth/depth", depth)
        if capture.sharp is not None and self._outputs.listened("ground_truth/image"):
            sharp = image_from_array(pixels_from_frame(capture.sharp, encoding), encoding, header)
            self._outputs.send("ground_truth/image", sharp)

    def _publish_picture(self, frame: NDArray, header: Header) -> None:
        """Publish a frame, raw and compressed, to those who subscribe."""
        raw = self._outputs.listened("image_raw")
        compressed = self._outputs.listened("image_raw/compressed")
        if not (raw or compressed):
            return
        config = self._config
        pixels = pixels_from_frame(frame, config.encoding)
        if raw:
            self._outputs.send("image_raw", image_from_array(pixels, config.encoding, header))
        if compressed:
            content = compressed_picture(
                pixels, config.encoding, config.compressed_format, config.jpeg_quality
            )
            self._outputs.send("image_raw/compressed", compressed_message(content, header))

    def _camera_info(self, capture: Capture, header: Header) -> CameraInfo | None:
        """Model of a calibration that was given, or the recorded one, or the file's; or none."""
        recorded = capture.camera_info
        if recorded is not None and not self._config.camera_info_url:
            return camera_info_from_recorded(recorded, header)
        height, width = capture.frame.shape[:2]
        try:
            model = self._store and self._store.model_for(width, height)
            model = model or self._camera.resized(width, height).intrinsics
        except InputError as error:
            self.get_logger().warning(
                f"camera_info not published: {error}", throttle_duration_sec=_LOG_PERIOD_S
            )
            return None
        return camera_info_from_camera(model, header)

    def _describe(self) -> dict[str, Any]:
        """Keyword arguments of `status_of`."""
        source = self._source
        config = self._config
        return {
            "config": self.configs[DiagnosticsConfig],
            "hardware_id": self._name,
            "waiting": source is not None and (source.live or self._failing),
            "active": self._active,
            "identity": {
                "source": config.source,
                "camera_file": self._camera_file,
                "failures": str(self._failures),
            },
        }
