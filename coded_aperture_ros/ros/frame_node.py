"""What every node that turns frames into other frames has in common."""

import contextlib
import dataclasses
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import option
from coded_aperture_ros.frames import PixelFormat
from coded_aperture_ros.frames.light import quantisation_sigma
from coded_aperture_ros.io.messages import MessageError
from coded_aperture_ros.ros.camera_model import CameraModel
from coded_aperture_ros.ros.diagnostics import (
    Complaint,
    DiagnosticsConfig,
    DiagnosticsPublisher,
    Statistics,
    camera_of,
)
from coded_aperture_ros.ros.managed_node import LONGEST_FRAME_S, ManagedNode
from coded_aperture_ros.ros.messages import image_from_compressed, stamp_ns
from coded_aperture_ros.ros.scheduling import NewestWorker, RateLimit
from coded_aperture_ros.ros.topics import Inputs, LocalTopics, Outputs

Item = TypeVar("Item")

_LAZY_PERIOD_S = 0.2
_LOG_PERIOD_S = 10.0
# What it waits in silence.
_PATIENCE_S = 2.0


@dataclasses.dataclass(frozen=True)
class FrameNodeConfig:
    """What every such node can be told about the frames that come."""

    parameter_group = "frames."
    gamma: float = option(1.0, "Gamma of 8-bit images; 1 for a linear sensor", within=(0.2, 5.0))
    bits: int = option(
        16,
        "Bits that 16-bit images have, where a sensor's 10 or 12 are not scaled to 16",
        within=(8, 16),
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
        """How the pixels of messages become linear light."""
        return PixelFormat(self.gamma, self.bits)


class FrameNode(ManagedNode, Generic[Item]):
    """A node that works on the newest frame, in a thread of its own, while someone listens.

    A node that derives from this one sets its `outputs`, topics and their message types, before the
    constructor of this class, calls `listen` for each input but the driver's `camera_info`,
    implements `load`, `unload` and `process`, and ends its constructor with `begin`. The arguments
    are those of `ManagedNode`, and `local` of the process that it shares with others.
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
        super().__init__(name, *configs, fixed=fixed, **node_options)
        self.statistics = Statistics()
        self._outputs = Outputs(self, self.outputs, local)
        self._inputs = Inputs(self, local)
        self.driver_info = CameraModel(self.reject)
        # Before the frames: of what has come, the executor takes what was subscribed to first.
        self.listen("camera_info", CameraInfo, self.driver_info.receive)
        self._logged_s: dict[str, float] = {}
        self._taken_up_s = 0.0
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

    def listen(self, topic: str, message_type: type, callback: Callable[[Any], None]) -> None:
        """Subscribe to an input; under `lazy` only while some output has a subscriber."""
        self._inputs.add(topic, message_type, callback)

    def listen_to_frames(self, topic: str, callback: Callable[[Image, float], None]) -> None:
        """Subscribe to frames, raw or compressed as the parameter `image_transport` says.

        The callback gets what compression has hidden, too; see `quantisation_sigma`.
        """
        if self.frame_config.image_transport == "raw":
            self.listen(topic, Image, lambda image: callback(image, 0.0))
            return

        def decompress(message: CompressedImage) -> None:
            try:
                image = image_from_compressed(message)
            except MessageError as error:
                self.statistics.count_received()
                self.reject(error.kind, str(error))
                return
            callback(image, quantisation_sigma(bytes(message.data)))

        self.listen(f"{topic}/compressed", CompressedImage, decompress)

    @abstractmethod
    def load(self) -> None:
        """Load files and plan the work; an `InputError` says why that cannot be done."""

    @abstractmethod
    def unload(self) -> None:
        """Let go of what `load` made, as far as it got."""

    @abstractmethod
    def process(self, item: Item) -> None:
        """Do the work on one item, in the worker's thread."""

    def restart(self) -> None:
        """Begin another video with the next frame, and let go of what waits for more input.

        Called, in any thread, when time has gone back, and when nobody listens any more.
        """
        self.driver_info.forget_stamps()

    def identity(self) -> dict[str, str]:
        """Return what /diagnostics says the node works with."""
        return {}

    @property
    def frame_config(self) -> FrameNodeConfig:
        """The present parameters about frames."""
        return self.configs[FrameNodeConfig]

    def set_up(self) -> None:
        """Load, create the publishers, and tell about the node from now on."""
        self.load()
        self._outputs.open()
        self._diagnostics = DiagnosticsPublisher(self, self.statistics, self._described)
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
        """Begin to listen and to work; where that fails, neither goes on."""
        with contextlib.ExitStack() as undo:
            undo.callback(self.stop_work)
            # Subscribed at once, so that a QoS override that cannot be met is found at start.
            self._inputs.open()
            self._worker = NewestWorker(
                self._process_safely, lambda: self.statistics.count_dropped("busy"), self.get_name()
            )
            self._update_listening()
            undo.pop_all()

    def stop_work(self) -> None:
        """Listen no more, and wait for the frame in work."""
        self._inputs.close()
        self._end_worker()
        self.restart()

    def end(self) -> None:
        """End the threads."""
        self._end_worker(LONGEST_FRAME_S)
        self.unload()

    def _end_worker(self, timeout_s: float | None = None) -> None:
        worker, self._worker = self._worker, None
        if worker is not None and not worker.stop(_PATIENCE_S):
            self.get_logger().info("waiting for the frame in work, which is not cut short")
            worker.stop(timeout_s and timeout_s - _PATIENCE_S)

    def offer(self, item: Item | None) -> None:
        """Hand an item, if any, to the worker as the rate allows; what still waits is dropped."""
        worker = self._worker
        if worker is None or item is None:
            return
        if self._rate_limit.takes(self.frame_config.max_rate_hz):
            worker.offer(item)
        else:
            self.statistics.count_dropped("max_rate")

    def wants(self, topic: str) -> bool:
        """Return whether an output has to be made."""
        return not self.frame_config.lazy or self._outputs.listened(topic)

    def send(self, topic: str, message: Any) -> None:
        """Publish an output."""
        self._outputs.send(topic, message)

    def sent(
        self,
        header: Header,
        stages_s: Mapping[str, float] | None = None,
        figures: Mapping[str, float] | None = None,
        complaint: Complaint | None = None,
    ) -> None:
        """Count the frame with this header as done; see `Statistics.count_processed`."""
        stamp = stamp_ns(header)
        # A stamp of zero is no time at all: simulated time had not begun, or nobody set it.
        now = self.get_clock().now().nanoseconds
        latency_s = (now - stamp) * 1e-9 if stamp else None
        work_s = time.monotonic() - self._taken_up_s
        self.statistics.count_processed(latency_s, work_s, stages_s, figures, complaint)

    def reject(self, kind: str, reason: str) -> None:
        """Count a message that cannot be used, and say why at most every ten seconds a kind."""
        self.statistics.count_rejected(kind, reason)
        now_s = time.monotonic()
        if now_s - self._logged_s.get(kind, -_LOG_PERIOD_S) >= _LOG_PERIOD_S:
            self._logged_s[kind] = now_s
            self.get_logger().warning(f"skipped: {reason}")

    def _process_safely(self, item: Item) -> None:
        self._taken_up_s = time.monotonic()
        try:
            self.process(item)
        except MessageError as error:
            self.reject(error.kind, str(error))
        except InputError as error:
            self.reject("frame", str(error))
        except Exception as error:
            # A robot goes on driving: one frame that meets a fault of ours must not end the node.
            self.reject("internal", f"internal error {type(error).__name__}: {error}")

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
        self.get_logger().info("time was set back: beginning anew")
        self.restart()

    def _described(self) -> dict[str, Any]:
        return {
            "config": self.configs[DiagnosticsConfig],
            "hardware_id": camera_of(self),
            "waiting": self._inputs.are_open,
            "active": self._worker is not None,
            "identity": self.identity(),
        }
