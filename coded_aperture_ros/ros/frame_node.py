"""Base class of the nodes that turn frames into other frames."""

import contextlib
import copy
import dataclasses
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import option
from coded_aperture_ros.frames import MOSAICS, PixelFormat
from coded_aperture_ros.frames.pictures import quantisation_sigma
from coded_aperture_ros.io.messages import MessageError, mosaic_encoding
from coded_aperture_ros.ros.camera_model import DriverInfo
from coded_aperture_ros.ros.diagnostics import (
    Complaint,
    DiagnosticsConfig,
    DiagnosticsPublisher,
    Statistics,
    camera_name,
)
from coded_aperture_ros.ros.managed_node import LONGEST_FRAME_S, ManagedNode
from coded_aperture_ros.ros.messages import image_from_compressed, stamp_ns
from coded_aperture_ros.ros.scheduling import NewestWorker, RateLimit
from coded_aperture_ros.ros.topics import Inputs, LocalTopics, Outputs

Item = TypeVar("Item")

# Time between two checks for a subscriber.
_LAZY_PERIOD_S = 0.2
# Shortest time between two log lines about messages with the same kind of fault.
_LOG_PERIOD_S = 10.0
# At shutdown, the frame in work may take so long before a line says what the node waits for.
# A preparation that takes longer is logged: on a new machine loops are compiled.
_LONG_WARM_UP_S = 2.0
_SHUTDOWN_LOG_DELAY_S = 2.0


@dataclasses.dataclass(frozen=True)
class FrameNodeConfig:
    """Options of every such node about its input frames."""

    parameter_group = "frames."
    gamma: float = option(1.0, "Gamma of 8-bit images; 1 for a linear sensor", within=(0.2, 5.0))
    bits: int = option(
        16,
        "Bits that 16-bit images have, where a sensor's 10 or 12 are not scaled to 16",
        within=(8, 16),
    )
    bayer: str = option(
        "",
        "Order of the colour filters of grey images that are a mosaic, where their encoding names "
        "none; empty: they are grey",
        choices=("", *MOSAICS),
    )
    max_rate_hz: float = option(
        0.0, "Most frames to process per second; 0: no limit", unit="Hz", within=(0, 10_000)
    )
    lazy: bool = option(True, "Work only while someone subscribes to an output", parameter="lazy")
    image_transport: str = option(
        "raw",
        "compressed: take frames from image_raw/compressed instead of image_raw",
        choices=("raw", "compressed"),
        read_only=True,
        parameter="image_transport",
    )

    @property
    def pixel_format(self) -> PixelFormat:
        """Pixel format that decodes the pixels of messages into linear light."""
        return PixelFormat(self.gamma, self.bits)


class FrameNode(ManagedNode, Generic[Item]):
    """Node that processes the newest frame in a worker thread, while an output has a subscriber.

    A subclass sets `outputs` before it calls the constructor of this class, calls `listen` for each
    input except the driver's `camera_info`, implements `load`, `unload` and `process`, and ends its
    constructor with `begin`.

    Parameters
    ----------
    name, *configs, fixed, **node_options
        As of `ManagedNode`.
    local : LocalTopics or None
        Topics inside the process, if it runs several nodes.

    Attributes
    ----------
    outputs : mapping of str to type
        Topics that the node publishes, and their message types.
    statistics : Statistics
    driver_info : DriverInfo
        Camera model that the driver sends.
    """

    outputs: Mapping[str, type]

    def __init__(
        self,
        name: str,
        *configs: Any,
        fixed: Mapping[str, Any],
        local: LocalTopics | None = None,
        **node_options: Any,
    ) -> None:
        configs = FrameNodeConfig(), DiagnosticsConfig(), *configs
        super().__init__(
            name, *configs, fixed=fixed, shares_arguments=local is not None, **node_options
        )
        self.statistics = Statistics()
        self._outputs = Outputs(self, self.outputs, local)
        self._inputs = Inputs(self, local)
        self.driver_info = DriverInfo(self.reject)
        # Before the frames: the executor serves the oldest subscription first.
        self.listen("camera_info", CameraInfo, self.driver_info.receive)
        self._logged_s: dict[str, float] = {}
        self._work_started_s = 0.0
        self._complains = False  # about the last frame
        self._rate_limit = RateLimit()
        self._worker: NewestWorker[Item] | None = None
        self._timer: Any = None
        self._diagnostics: DiagnosticsPublisher | None = None
        self._jumps = self.get_clock().create_jump_callback(
            JumpThreshold(
                min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True
            ),
            post_callback=self._on_jump,
        )

    def listen(
        self,
        topic: str,
        message_type: type,
        callback: Callable[[Any], None],
        qos: QoSProfile | None = None,
    ) -> None:
        """Subscribe to an input; under `lazy` only while some output has a subscriber."""
        self._inputs.add(topic, message_type, callback, qos)

    def listen_to_frames(self, topic: str, callback: Callable[[Image, float], None]) -> None:
        """Subscribe to frames, raw or compressed as the parameter `image_transport` says.

        Parameters
        ----------
        topic : str
        callback : callable
            Called with the image and its compression loss: the noise that lossy compression has
            hidden, in stored values from 0 to 1; see `quantisation_sigma`.
        """

        def take(image: Image, compression_loss: float = 0.0) -> None:
            encoding = mosaic_encoding(image.encoding, self.frame_config.bayer)
            if encoding != image.encoding:
                image = copy.copy(image)  # nodes of one process share messages
                image.encoding = encoding
            callback(image, compression_loss)

        if self.frame_config.image_transport == "raw":
            self.listen(topic, Image, take)
            return

        def decompress(message: CompressedImage) -> None:
            try:
                image = image_from_compressed(message)
            except MessageError as error:
                self.statistics.count_received()
                self.reject(error.kind, str(error))
                return
            take(image, quantisation_sigma(bytes(message.data)))

        self.listen(f"{topic}/compressed", CompressedImage, decompress)

    @abstractmethod
    def load(self) -> None:
        """Load files and prepare the work.

        Raises
        ------
        InputError
            If a file or a parameter cannot be used.
        """

    @abstractmethod
    def unload(self) -> None:
        """Release what `load` made, also where it failed half-way."""

    @abstractmethod
    def process(self, item: Item) -> None:
        """Process one item and publish the results; called in the worker's thread."""

    def warm_up(self) -> None:
        """Do what the first frame would wait for; called in the worker's thread."""

    def restart(self) -> None:
        """Start a new video with the next frame, and drop what waits for more input.

        Called, in any thread, when the clock jumps back and when no output has a subscriber left.
        """
        self.driver_info.forget_stamps()

    def identity(self) -> dict[str, str]:
        """Keys and values of /diagnostics that name the files that the node uses."""
        return {}

    @property
    def frame_config(self) -> FrameNodeConfig:
        """Present options of input frames."""
        return self.configs[FrameNodeConfig]

    def set_up(self) -> None:
        """Load, create the publishers, and start to publish diagnostics."""
        self.load()
        self._outputs.open()
        self._diagnostics = DiagnosticsPublisher(self, self.statistics, self._describe)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self.create_timer(_LAZY_PERIOD_S, self._update_listening, clock=steady)

    def clean_up(self) -> None:
        """Undo `set_up`."""
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        if self._diagnostics is not None:
            self._diagnostics.close()
            self._diagnostics = None
        self.configs.forget_listeners()
        self._outputs.close()
        self.unload()

    def start_work(self) -> None:
        """Subscribe and start the worker; where one of them fails, neither is left."""
        with contextlib.ExitStack() as undo:
            undo.callback(self.stop_work)
            # Subscribed at once, so that a QoS override that cannot be met is found at start.
            self._inputs.open()
            self._worker = NewestWorker(
                self._process_safely,
                lambda: self.statistics.count_dropped("busy"),
                self.get_name(),
                self._warm_up_safely,
            )
            self._update_listening()
            undo.pop_all()

    def stop_work(self) -> None:
        """End the subscriptions, and wait for the frame in work."""
        self._inputs.close()
        self._end_worker()
        self.restart()

    def end(self) -> None:
        """End the threads."""
        self._end_worker(LONGEST_FRAME_S)
        self.unload()

    def _end_worker(self, timeout_s: float | None = None) -> None:
        worker, self._worker = self._worker, None
        if worker is not None and not worker.stop(_SHUTDOWN_LOG_DELAY_S):
            self.get_logger().info("shutting down: waiting for the frame in work")
            worker.stop(timeout_s and timeout_s - _SHUTDOWN_LOG_DELAY_S)

    def offer(self, item: Item | None) -> None:
        """Hand an item to the worker unless it exceeds `max_rate_hz`; None is ignored.

        It replaces an item that still waits, which is counted as dropped.
        """
        worker = self._worker
        if worker is None or item is None:
            return
        if self._rate_limit.takes(self.frame_config.max_rate_hz):
            worker.offer(item)
        else:
            self.statistics.count_dropped("max_rate")

    def wants(self, topic: str) -> bool:
        """Whether an output is needed: it has a subscriber, or the node is not lazy."""
        return not self.frame_config.lazy or self._outputs.listened(topic)

    def send(self, topic: str, message: Any) -> None:
        """Publish an output."""
        self._outputs.send(topic, message)

    def finish_frame(
        self,
        header: Header,
        stages_s: Mapping[str, float] | None = None,
        figures: Mapping[str, float] | None = None,
        complaint: Complaint | None = None,
    ) -> None:
        """Count the frame with this header as processed; see `Statistics.count_processed`."""
        stamp = stamp_ns(header)
        # A stamp of zero is not a time: simulated time had not begun, or the driver set none.
        now = self.get_clock().now().nanoseconds
        latency_s = (now - stamp) * 1e-9 if stamp else None
        work_s = time.monotonic() - self._work_started_s
        self.statistics.count_processed(latency_s, work_s, stages_s, figures, complaint)
        if complaint is not None and not self._complains:  # the first of a series
            self.get_logger().warning(complaint.text, throttle_duration_sec=_LOG_PERIOD_S)
        self._complains = complaint is not None

    def reject(self, kind: str, reason: str) -> None:
        """Count an unusable message, and log why, at most every 10 s for each kind of fault."""
        self.statistics.count_rejected(kind, reason)
        now_s = time.monotonic()
        if now_s - self._logged_s.get(kind, -_LOG_PERIOD_S) >= _LOG_PERIOD_S:
            self._logged_s[kind] = now_s
            self.get_logger().warning(f"skipped: {reason}")

    def _process_safely(self, item: Item) -> None:
        self._work_started_s = time.monotonic()
        try:
            self.process(item)
        except MessageError as error:
            self.reject(error.kind, str(error))
        except InputError as error:
            self.reject("frame", str(error))
        except Exception as error:
            # The robot keeps driving: an internal error in one frame must not end the node.
            self.reject("internal", f"internal error {type(error).__name__}: {error}")

    def _warm_up_safely(self) -> None:
        started_s = time.monotonic()
        try:
            self.warm_up()
        except Exception as error:  # a frame that has this fault says more about it
            self.get_logger().info(f"not prepared for the first frame: {error}")
            return
        took_s = time.monotonic() - started_s
        if took_s > _LONG_WARM_UP_S:
            self.get_logger().info(f"ready for frames: planned and compiled in {took_s:.1f} s")

    def _update_listening(self) -> None:
        if self._worker is None:
            return
        wanted = not self.frame_config.lazy or self._outputs.listened()
        if wanted and not self._inputs.are_open:
            self._inputs.open()
        elif not wanted and self._inputs.are_open:
            self._inputs.close()
            self.restart()

    def _on_jump(self, jump: TimeJump) -> None:
        self.get_logger().info("clock jumped back, resetting")
        self.restart()

    def _describe(self) -> dict[str, Any]:
        return {
            "config": self.configs[DiagnosticsConfig],
            "hardware_id": camera_name(self),
            "waiting": self._inputs.are_open,
            "active": self._worker is not None,
            "identity": self.identity(),
        }
