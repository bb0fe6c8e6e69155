"""The demo's onlooker: measures what the other nodes publish, as any subscriber would."""

import threading
import time
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image

from coded_aperture_ros.metrics.errors import DepthError, depth_error, psnr_db
from coded_aperture_ros.ros.diagnostics import percentiles
from coded_aperture_ros.ros.messages import array_from_image, frame_from_image, stamp_ns

CODED, DEPTH, CONFIDENCE, DEBLURRED = (
    "image_raw",
    "depth/image",
    "depth/confidence",
    "deblurred/image",
)
TRUE_DEPTH, TRUE_IMAGE = "ground_truth/depth", "ground_truth/image"
_MEASURED = (CODED, DEPTH, DEBLURRED)
# Frames to keep until the last of their results has come.
_KEPT_FRAMES = 60


@dataclass(frozen=True)
class StreamFigures:
    """What was received on one topic; latency from the stamp to the reception."""

    frames: int
    rate_hz: float
    rates_hz: list[int]
    latency_s: tuple[float, float, float] | None


@dataclass(frozen=True)
class Snapshot:
    """One frame with everything that was made from it; arrays as in the library."""

    coded: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    confidence: NDArray[np.float32]
    all_in_focus: NDArray[np.float32]
    true_image: NDArray[np.float32]
    true_depth_m: NDArray[np.float32]

    def depth_error(self) -> DepthError:
        """Return the error of the depth map."""
        truth = resampled(self.true_depth_m, self.depth_m.shape)
        return depth_error(self.depth_m, self.confidence, truth)

    def psnr_db(self) -> tuple[float, float]:
        """Return the PSNR of the coded and of the all-in-focus frame, in dB."""
        return psnr_db(self.coded, self.true_image), psnr_db(self.all_in_focus, self.true_image)


class DemoMonitor(Node):
    """Subscribes to everything, counts, and compares with the simulator's truth."""

    def __init__(self, context: Context, reliable: bool) -> None:
        super().__init__("demo_monitor", context=context)
        self._qos = QoSProfile(
            depth=5,
            history=HistoryPolicy.KEEP_LAST,
            reliability=(ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT),
        )
        self._lock = threading.Lock()
        self._arrivals: dict[str, list[tuple[float, float]]] = {topic: [] for topic in _MEASURED}
        self._frames: dict[int, dict[str, Image]] = {}
        self._errors: deque[DepthError] = deque(maxlen=2000)
        self._reported: dict[str, dict[str, str]] = {}
        self._before: Counter[tuple[str, str]] = Counter()
        self._begun_s = time.monotonic()
        self._truth_wanted = False
        for topic in (CODED, DEPTH, CONFIDENCE, DEBLURRED, TRUE_DEPTH):
            self._subscribe(topic)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def begin(self) -> None:
        """Begin the measurement: forget what was received until now."""
        with self._lock:
            self._begun_s = time.monotonic()
            for arrivals in self._arrivals.values():
                arrivals.clear()
            self._errors.clear()
            self._before = Counter(
                {
                    (node, key): int(value)
                    for node, values in self._reported.items()
                    for key, value in values.items()
                    if value.isdigit()
                }
            )

    def received(self, topic: str) -> int:
        """Return how many messages came on a measured topic since `begin`."""
        with self._lock:
            return len(self._arrivals[topic])

    def figures(self, topic: str) -> StreamFigures:
        """Return rate and latency of a measured topic since `begin`."""
        with self._lock:
            arrivals = list(self._arrivals[topic])
            elapsed_s = time.monotonic() - self._begun_s
        seconds = [int(arrived_s - self._begun_s) for arrived_s, _ in arrivals]
        return StreamFigures(
            len(arrivals),
            len(arrivals) / max(elapsed_s, 1e-3),
            np.bincount(seconds, minlength=max(int(elapsed_s), 0))[: int(elapsed_s)].tolist(),
            percentiles([latency_s for _, latency_s in arrivals]),
        )

    def depth_errors(self) -> list[DepthError]:
        """Return the errors of the depth images compared since `begin`."""
        with self._lock:
            return list(self._errors)

    def count(self, node: str, key: str) -> int:
        """Return a count from a node's diagnostics since `begin`."""
        with self._lock:
            return int(self._reported.get(node, {}).get(key, 0)) - self._before[node, key]

    def want_true_image(self) -> None:
        """Subscribe to the true image as well, for a snapshot."""
        if not self._truth_wanted:
            self._truth_wanted = True
            self._subscribe(TRUE_IMAGE)

    def snapshot(self) -> Snapshot | None:
        """Return the newest frame of which everything has been received."""
        wanted = (CODED, DEPTH, CONFIDENCE, DEBLURRED, TRUE_IMAGE, TRUE_DEPTH)
        with self._lock:
            complete = [
                frame for frame in self._frames.values() if all(topic in frame for topic in wanted)
            ]
        if not complete:
            return None
        frame = complete[-1]
        return Snapshot(
            coded=frame_from_image(frame[CODED]),
            depth_m=array_from_image(frame[DEPTH]),
            confidence=array_from_image(frame[CONFIDENCE]),
            all_in_focus=frame_from_image(frame[DEBLURRED]),
            true_image=frame_from_image(frame[TRUE_IMAGE]),
            true_depth_m=array_from_image(frame[TRUE_DEPTH]),
        )

    def _subscribe(self, topic: str) -> None:
        self.create_subscription(
            Image, topic, lambda image: self._on_image(topic, image), self._qos
        )

    def _on_image(self, topic: str, image: Image) -> None:
        arrived_s = time.monotonic()
        stamp = stamp_ns(image.header)
        latency_s = (self.get_clock().now().nanoseconds - stamp) * 1e-9
        with self._lock:
            if topic in self._arrivals:
                self._arrivals[topic].append((arrived_s, latency_s))
            frame = self._frames.setdefault(stamp, {})
            frame[topic] = image
            self._forget_frames(stamp, topic)
            if topic not in (DEPTH, CONFIDENCE) or not {DEPTH, CONFIDENCE, TRUE_DEPTH} <= set(
                frame
            ):
                return
        estimate, truth = array_from_image(frame[DEPTH]), array_from_image(frame[TRUE_DEPTH])
        error = depth_error(
            estimate, array_from_image(frame[CONFIDENCE]), resampled(truth, estimate.shape)
        )
        with self._lock:
            self._errors.append(error)

    def _forget_frames(self, stamp: int, topic: str) -> None:
        if topic in (DEPTH, DEBLURRED):
            # Results come in order: older frames without this one were dropped on the way.
            for old in [t for t, frame in self._frames.items() if t < stamp and topic not in frame]:
                del self._frames[old]
        while len(self._frames) > _KEPT_FRAMES:
            del self._frames[min(self._frames)]

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        with self._lock:
            for status in message.status:
                node = status.name.partition(":")[0].rpartition("/")[2]
                self._reported[node] = {pair.key: pair.value for pair in status.values}


def resampled(depth_m: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return a depth map at another size, each value one that it had: depths are never mixed."""
    if depth_m.shape == shape:
        return depth_m
    return cv2.resize(depth_m, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST_EXACT)


@contextmanager
def running_monitor(reliable: bool = False) -> Iterator[DemoMonitor]:
    """Run a monitor in a thread, in a context of its own.

    Parameters
    ----------
    reliable : bool
        Ask for lost images again.
    """
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    monitor = DemoMonitor(context, reliable)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(monitor)
    spinner = threading.Thread(target=_spin, args=(executor,), name="monitor", daemon=True)
    spinner.start()
    try:
        yield monitor
    finally:
        executor.shutdown()
        spinner.join(5.0)
        monitor.destroy_node()
        context.try_shutdown()


def _spin(executor: SingleThreadedExecutor) -> None:
    try:
        executor.spin()
    except ExternalShutdownException:
        return
