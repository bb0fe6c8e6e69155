"""What every node that turns frames into other frames has in common."""

import dataclasses
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions
from std_msgs.msg import Header

from coded_aperture_ros.configuration import check_options, option
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.nodes.diagnostics import DiagnosticsPublisher, Statistics
from coded_aperture_ros.nodes.messages import MessageError, stamp_ns
from coded_aperture_ros.nodes.newest import NewestWorker
from coded_aperture_ros.nodes.parameters import NodeParameters
from coded_aperture_ros.nodes.rate_limit import RateLimit
from coded_aperture_ros.nodes.running import publish

Item = TypeVar("Item")

_LAZY_PERIOD_S = 0.2
_LOG_PERIOD_S = 10.0


@dataclasses.dataclass(frozen=True)
class FrameNodeConfig:
    """What every such node can be told about the frames that come."""

    gamma: float = option(
        1.0, "Gamma of 8-bit images; 1 for a linear sensor", minimum=0.2, maximum=5.0
    )
    max_rate_hz: float = option(
        0.0, "Most frames to process per second; 0: no limit", unit="Hz", minimum=0, maximum=10_000
    )
    lazy: bool = option(True, "Work only while someone subscribes to an output")

    def __post_init__(self) -> None:
        check_options(self)


class FrameNode(ABC, Node, Generic[Item]):
    """A node that works on the newest frame, in a thread of its own, while someone listens.

    A node that derives from this one calls `advertise` for each output and `listen` for each
    input, implements `process`, and ends its constructor with `start`.

    Parameters
    ----------
    name : str
        Of the node.
    *configs : dataclass instances
        The defaults of the node's parameters; see `NodeParameters`.
    fixed : dict
        Further ones that cannot change while the node runs, by the prefix of their names.
    **node_options
        Those of `rclpy.node.Node`, such as `context` and `namespace`.
    """

    def __init__(
        self, name: str, *configs: Any, fixed: Mapping[str, Any], **node_options: Any
    ) -> None:
        super().__init__(name, **node_options)
        self.configs = NodeParameters(self, FrameNodeConfig(), *configs, fixed=fixed)
        self.statistics = Statistics()
        self._outputs: dict[str, Any] = {}
        self._inputs: list[Callable[[], Any]] = []
        self._listening: list[Any] = []
        self._logged_s: dict[str, float] = {}
        self._taken_up_s = 0.0
        self._rate_limit = RateLimit()
        self._worker: NewestWorker[Item] | None = None

    def advertise(self, topic: str, message_type: type) -> None:
        """Create the publisher of an output."""
        self._outputs[topic] = overridable_publisher(self, message_type, topic)

    def listen(self, topic: str, message_type: type, callback: Callable[[Any], None]) -> None:
        """Subscribe to an input; under `lazy` only while some output has a subscriber."""
        self._inputs.append(lambda: overridable_subscription(self, message_type, topic, callback))

    def start(self) -> None:
        """Begin to work; the last thing that a constructor does."""
        self._worker = NewestWorker(
            self._process_safely, self.statistics.count_dropped, self.get_name()
        )
        # Subscribed at once, so that a QoS override that cannot be met is found at start.
        self._listening = [subscribe() for subscribe in self._inputs]
        self._update_listening()
        self.create_timer(
            _LAZY_PERIOD_S, self._update_listening, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        DiagnosticsPublisher(self, self.statistics, lambda: bool(self._listening))

    @abstractmethod
    def process(self, item: Item) -> None:
        """Do the work on one item, in the worker's thread."""

    def rest(self) -> None:
        """Let go of what waits for more input; called when nobody listens any more."""

    @property
    def frame_config(self) -> FrameNodeConfig:
        """The present parameters about frames."""
        return self.configs[FrameNodeConfig]

    def offer(self, item: Item) -> None:
        """Hand an item to the worker, unless the rate is limited; what still waits is dropped."""
        if self._worker is None:
            return
        if self._rate_limit.takes(self.frame_config.max_rate_hz):
            self._worker.offer(item)
        else:
            self.statistics.count_dropped()

    def wants(self, topic: str) -> bool:
        """Return whether an output has to be made."""
        return not self.frame_config.lazy or self._outputs[topic].get_subscription_count() > 0

    def send(self, topic: str, message: Any) -> None:
        """Publish an output."""
        publish(self, self._outputs[topic], message)

    def sent(self, header: Header, stages_s: Mapping[str, float] | None = None) -> None:
        """Count a frame as done.

        `header` is that of the frame that the outputs came from, `stages_s` the time that each
        stage of the work took, if it is known.
        """
        stamp = stamp_ns(header)
        # A stamp of zero is no time at all: simulated time had not begun, or nobody set it.
        now = self.get_clock().now().nanoseconds
        latency_s = (now - stamp) * 1e-9 if stamp else None
        self.statistics.count_processed(latency_s, time.monotonic() - self._taken_up_s, stages_s)

    def reject(self, kind: str, reason: str) -> None:
        """Count a message that cannot be used, and say why at most every ten seconds a kind."""
        self.statistics.count_rejected(kind)
        now_s = time.monotonic()
        if now_s - self._logged_s.get(kind, -_LOG_PERIOD_S) >= _LOG_PERIOD_S:
            self._logged_s[kind] = now_s
            self.get_logger().warning(f"skipped: {reason}")

    def close(self) -> None:
        """End the worker; the node can then be destroyed."""
        if self._worker is not None:
            self._worker.stop()

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
        wanted = any(self.wants(topic) for topic in self._outputs)
        if wanted and not self._listening:
            self._listening = [subscribe() for subscribe in self._inputs]
        elif not wanted and self._listening:
            for subscription in self._listening:
                self.destroy_subscription(subscription)
            self._listening = []
            self.rest()


def overridable_publisher(node: Node, message_type: type, topic: str) -> Any:
    """Create a publisher of results whose QoS users can change by parameters.

    Reliable, because such a publisher serves every kind of subscriber.
    """
    qos = QoSProfile(
        depth=5, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE
    )
    with _readable_qos_errors(topic):
        return node.create_publisher(
            message_type,
            topic,
            qos,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )


def overridable_subscription(
    node: Node, message_type: type, topic: str, callback: Callable[[Any], None]
) -> Any:
    """Create a subscription to frames whose QoS users can change by parameters.

    For sensor data of which only the newest matters.
    """
    qos = QoSProfile(
        depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT
    )
    with _readable_qos_errors(topic):
        return node.create_subscription(
            message_type,
            topic,
            callback,
            qos,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )


@contextmanager
def _readable_qos_errors(topic: str) -> Iterator[None]:
    try:
        yield
    except (RuntimeError, ParameterException, InvalidQosOverridesError) as error:
        raise InputError(f"topic {topic}: {error}") from error
