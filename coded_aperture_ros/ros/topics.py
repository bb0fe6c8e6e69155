"""The topics that a node publishes and subscribes to, over DDS and inside its process."""

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from coded_aperture_ros.core.errors import InputError

# History, depth and reliability of every topic are parameters.
_OVERRIDABLE = QoSOverridingOptions.with_default_policies()


class LocalTopics:
    """Hands messages from node to node as they are, without serialising them.

    A node that subscribes to a topic that another node of the process offers gets its messages
    from here, and not over DDS. Messages are shared: whoever receives one must not change it.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._offered: set[str] = set()
        self._callbacks: dict[str, list[Callable[[Any], None]]] = {}

    def offer(self, topic: str) -> None:
        """Say that a node of this process publishes a topic, by its full name."""
        with self._lock:
            self._offered.add(topic)

    def offers(self, topic: str) -> bool:
        """Return whether a node of this process publishes a topic."""
        with self._lock:
            return topic in self._offered

    def subscribe(self, topic: str, callback: Callable[[Any], None]) -> Callable[[], None]:
        """Have a topic's messages handed to a function; return what ends that.

        The function is called in the thread that publishes, and must be quick.
        """
        with self._lock:
            # A new list: one that is being gone through stays as it is.
            self._callbacks[topic] = [*self._callbacks.get(topic, []), callback]

        def unsubscribe() -> None:
            with self._lock:
                self._callbacks[topic] = [
                    other for other in self._callbacks[topic] if other is not callback
                ]

        return unsubscribe

    def listeners(self, topic: str) -> int:
        """Return how many functions wait for a topic."""
        with self._lock:
            return len(self._callbacks.get(topic, []))

    def publish(self, topic: str, message: Any) -> None:
        """Hand a message to all who wait for it."""
        with self._lock:
            callbacks = self._callbacks.get(topic, [])
        for callback in callbacks:
            callback(message)


class Outputs:
    """The topics of a node's results, with QoS that users can change by parameters.

    Reliable, because such a publisher serves every kind of subscriber. `types` has the message type
    of every topic; `local` is of the process that the node shares with others, if it does.
    """

    def __init__(self, node: Node, types: Mapping[str, type], local: LocalTopics | None) -> None:
        self._node = node
        self._types = dict(types)
        self._local = local
        self._publishers: dict[str, Any] = {}
        self._names = {topic: node.resolve_topic_name(topic) for topic in types}
        if local is not None:
            for name in self._names.values():
                local.offer(name)

    def open(self) -> None:
        """Create the publishers."""
        for topic, message_type in self._types.items():
            qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
            with _readable_qos_errors(topic):
                self._publishers[topic] = self._node.create_publisher(
                    message_type, topic, qos, qos_overriding_options=_OVERRIDABLE
                )

    def close(self) -> None:
        """Destroy the publishers."""
        publishers, self._publishers = self._publishers, {}
        for publisher in publishers.values():
            self._node.destroy_publisher(publisher)

    def listened(self, topic: str | None = None) -> bool:
        """Return whether anyone subscribes to a topic, or to any of them."""
        if topic is None:
            return any(self.listened(each) for each in self._publishers)
        if topic not in self._publishers:
            return False
        if self._local is not None and self._local.listeners(self._names[topic]):
            return True
        return bool(self._publishers[topic].get_subscription_count())

    def send(self, topic: str, message: Any) -> None:
        """Publish a message, unless the node's context has been shut down meanwhile."""
        if self._local is not None:
            self._local.publish(self._names[topic], message)
        publisher = self._publishers.get(topic)
        # Without a subscriber it would still be serialised.
        if publisher is None or not publisher.get_subscription_count():
            return
        try:
            publisher.publish(message)
        except Exception:
            # rclpy raises several kinds here, one of them private; only a shutdown excuses them.
            if self._node.context.ok():
                raise


class Inputs:
    """The topics that a node listens to: sensor data, of which only the newest matters.

    `local` is of the process that the node shares with others: what they publish comes from there.
    """

    def __init__(self, node: Node, local: LocalTopics | None) -> None:
        self._node = node
        self._local = local
        self._wanted: list[tuple[str, type, Callable[[Any], None]]] = []
        self._endings: list[Callable[[], Any]] = []
        # Messages come from the executor and from the threads of the other nodes.
        self._one_at_a_time = threading.Lock()

    def add(self, topic: str, message_type: type, callback: Callable[[Any], None]) -> None:
        """Listen to a topic whenever the inputs are open."""

        def one_at_a_time(message: Any) -> None:
            with self._one_at_a_time:
                callback(message)

        self._wanted.append((topic, message_type, one_at_a_time))

    @property
    def are_open(self) -> bool:
        """Whether the node listens."""
        return bool(self._endings)

    def open(self) -> None:
        """Subscribe to all topics, or to none.

        Raises `InputError` if a QoS override cannot be met.
        """
        with ExitStack() as undo:
            undo.callback(self.close)
            for topic, message_type, callback in self._wanted:
                name = self._node.resolve_topic_name(topic)
                if self._local is not None and self._local.offers(name):
                    self._endings.append(self._local.subscribe(name, callback))
                    continue
                qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
                with _readable_qos_errors(topic):
                    subscription = self._node.create_subscription(
                        message_type, topic, callback, qos, qos_overriding_options=_OVERRIDABLE
                    )
                self._endings.append(partial(self._node.destroy_subscription, subscription))
            undo.pop_all()

    def close(self) -> None:
        """End the subscriptions."""
        endings, self._endings = self._endings, []
        for end in endings:
            end()


@contextmanager
def _readable_qos_errors(topic: str) -> Iterator[None]:
    try:
        yield
    except (RuntimeError, ParameterException, InvalidQosOverridesError) as error:
        raise InputError(f"topic {topic}: {error}") from error
