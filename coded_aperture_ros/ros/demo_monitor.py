"""Measurements of the demo: what the other nodes publish, as any subscriber receives it."""

import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import AbstractContextManager

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

from coded_aperture_ros.bags.score import resize_reference
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth import core_maps
from coded_aperture_ros.io.messages import array_from_image, frame_from_image
from coded_aperture_ros.metrics.errors import DepthError, depth_error
from coded_aperture_ros.ros.messages import stamp_ns
from coded_aperture_ros.ros.running import node_in_thread

CODED = "image_raw"
DEBLURRED = "deblurred/image"
DEPTH = core_maps.DEPTH.topic
CONFIDENCE = core_maps.CONFIDENCE.topic
TRUE_DEPTH = "ground_truth/depth"
TRUE_IMAGE = "ground_truth/image"
ALL = (CODED, DEPTH, CONFIDENCE, DEBLURRED, TRUE_DEPTH)
_MEASURED = (CODED, DEPTH, DEBLURRED)
_PICTURES = (CODED, DEBLURRED, TRUE_IMAGE)
_MAPS = (DEPTH, CONFIDENCE, TRUE_DEPTH)
# Frames kept until the last of their results has come.
_KEPT_FRAMES = 60
# Results before which nodes do not count as ready: they may still drop the first frames.
_FIRST_FRAMES = 3
# Errors kept, of the newest depth images.
_KEPT_ERRORS = 2000


class DemoMonitor(Node):
    """Subscribes to topics, counts results, and compares depth with the ground truth."""

    def __init__(self, context: Context, reliable: bool, topics: Sequence[str] = ALL) -> None:
        super().__init__("demo_monitor", context=context)
        wanted = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        self._qos = QoSProfile(depth=5, reliability=wanted)
        self._lock = threading.Lock()
        self._arrivals: dict[str, list[tuple[float, float]]] = {topic: [] for topic in _MEASURED}
        self._frames: dict[int, dict[str, Image]] = {}
        self._errors: deque[DepthError] = deque(maxlen=_KEPT_ERRORS)
        self._reported: dict[str, dict[str, str]] = {}
        self._before: dict[str, dict[str, str]] = {}
        self._begun_s = time.monotonic()
        self._awaited = [topic for topic in (DEPTH, DEBLURRED) if topic in topics]
        for topic in topics:
            self._subscribe(topic)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def begin(self) -> None:
        """Start the measurement: forget what was received until now."""
        with self._lock:
            self._begun_s = time.monotonic()
            for arrivals in self._arrivals.values():
                arrivals.clear()
            self._errors.clear()
            self._before = {node: dict(values) for node, values in self._reported.items()}

    def has_results(self) -> bool:
        """Whether some results of each node have come since `begin`."""
        with self._lock:
            return all(len(self._arrivals[topic]) >= _FIRST_FRAMES for topic in self._awaited)

    def arrivals(self, topic: str) -> list[tuple[float, float]]:
        """Time of each message of a measured topic, s from `begin`, and its latency, s.

        Latencies are from the stamp to the reception.
        """
        with self._lock:
            return [(at_s - self._begun_s, latency_s) for at_s, latency_s in self._arrivals[topic]]

    def depth_errors(self) -> list[DepthError]:
        """Errors of the depth images since `begin`."""
        with self._lock:
            return list(self._errors)

    def count(self, node: str, key: str) -> int:
        """Increase of a counter in a node's diagnostics since `begin`."""
        with self._lock:
            now, before = (of.get(node, {}).get(key, 0) for of in (self._reported, self._before))
        return int(now) - int(before)

    def want_true_image(self) -> None:
        """Subscribe to the true image as well, for a snapshot."""
        self._subscribe(TRUE_IMAGE)

    def snapshot(self) -> dict[str, FloatArray] | None:
        """Newest complete frame, as arrays by their topics; None before the first."""
        wanted = {*_PICTURES, *_MAPS}
        with self._lock:
            complete = [frame for frame in self._frames.values() if wanted <= frame.keys()]
        if not complete:
            return None
        return {
            topic: frame_from_image(image).light if topic in _PICTURES else array_from_image(image)
            for topic, image in complete[-1].items()
        }

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
            if topic not in (DEPTH, CONFIDENCE) or not {*_MAPS} <= frame.keys():
                return
        error = map_error(*(array_from_image(frame[topic]) for topic in _MAPS))
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


def map_error(depth_m: FloatArray, confidence: FloatArray, true_depth_m: FloatArray) -> DepthError:
    """Error of a depth map, m [rows, columns], whose size may differ from the ground truth's."""
    return depth_error(depth_m, confidence, resize_reference(true_depth_m, depth_m.shape))


def running_monitor(
    reliable: bool = False, topics: Sequence[str] = ALL
) -> AbstractContextManager[DemoMonitor]:
    """Run a monitor in a thread; with `reliable`, lost images are sent again."""
    return node_in_thread(lambda context: DemoMonitor(context, reliable, topics), "monitor")
