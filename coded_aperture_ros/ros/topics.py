"""Publishers and subscriptions of a node, over DDS and inside its process."""

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.ros.incompatible_subscribers import IncompatibleSubscribers

# Makes history, depth and reliability of every topic parameters.
_OVERRIDABLE = QoSOverridingOptions.with_default_policies()


class LocalTopics:
    """Topics inside a process: messages go from node to node without being serialised.

    A node that subscribes to a topic that another node of the process offers gets its messages
    from here, and not over DDS. Messages are shared: a receiver must not change them.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._offered: set[str] = set()
        self._callbacks: dict[str, list[Callable[[Any], None]]] = {}

    def offer(self, topic: str) -> None:
        """Register a topic, by its full name, that a node of this process publishes."""
        with self._lock:
            self._offered.add(topic)

    def offers(self, topic: str) -> bool:
        """Whether a node of this process publishes a topic."""
        with self._lock:
            return topic in self._offered

    def subscribe(self, topic: str, callback: Callable[[Any], None]) -> Callable[[], None]:
        """Subscribe a function to a topic; return a function that unsubscribes it.

        It is called in the thread that publishes, and must return quickly.
        """
        with self._lock:
            # A new list: `publish` may be iterating over the old one.
            self._callbacks[topic] = [*self._callbacks.get(topic, []), callback]

        def unsubscribe() -> None:
            with self._lock:
                self._callbacks[topic] = [
                    other for other in self._callbacks[topic] if other is not callback
                ]

        return unsubscribe

    def listeners(self, topic: str) -> int:
        """Number of functions that are subscribed to a topic."""
        with self._lock:
            return len(self._callbacks.get(topic, []))

    def publish(self, topic: str, message: Any) -> None:
        """Call the subscribed functions with a message."""
        with self._lock:
            callbacks = self._callbacks.get(topic, [])
        for callback in callbacks:
            callback(message)


class Outputs:
    """Publishers of a node, with QoS that users can change by parameters.

    They are reliable, because such a publisher serves every kind of subscriber.

    Parameters
    ----------
    node : Node
    types : mapping of str to type
        Message type of each topic.
    local : LocalTopics or None
        Topics inside the process, if it runs several nodes.
    """

    def __init__(self, node: Node, types: Mapping[str, type], local: LocalTopics | None) -> None:
        self._node = node
        self._types = dict(types)
        self._local = local
        self._publishers: dict[str, Any] = {}
        self._incompatible: IncompatibleSubscribers | None = None
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
                    message_type,
                    topic,
                    qos,
                    event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
                    qos_overriding_options=_OVERRIDABLE,
                )
        self._incompatible = IncompatibleSubscribers(self._node, self._publishers)

    def close(self) -> None:
        """Destroy the publishers."""
        if self._incompatible is not None:
            self._incompatible.close()
            self._incompatible = None
        publishers, self._publishers = self._publishers, {}
        for publisher in publishers.values():
            self._node.destroy_publisher(publisher)

    def listened(self, topic: str | None = None) -> bool:
        """Whether a topic has a subscriber; without a topic, whether any of them has."""
        if topic is None:
            return any(self.listened(each) for each in self._publishers)
        if topic not in self._publishers:
            return False
        if self._local is not None and self._local.listeners(self._names[topic]):
            return True
        return bool(self._publishers[topic].get_subscription_count())

    def send(self, topic: str, message: Any) -> None:
        """Publish a message; ignored once the node's context has been shut down."""
        if self._local is not None:
            self._local.publish(self._names[topic], message)
        publisher = self._publishers.get(topic)
        # Without a subscriber it would still be serialised.
        if publisher is None or not publisher.get_subscription_count():
            return
        try:
            publisher.publish(message)
        except Exception:
            # rclpy raises several kinds here, one of them private; a shutdown explains all of them.
            if self._node.context.ok():
                raise


class Inputs:
    """Subscriptions of a node, mostly to sensor data, of which only the newest matters.

    Parameters
    ----------
    node : Node
    local : LocalTopics or None
        Topics inside the process, which are preferred to DDS.
    """

    def __init__(self, node: Node, local: LocalTopics | None) -> None:
        self._node = node
        self._local = local
        self._topics: list[tuple[str, type, Callable[[Any], None], QoSProfile]] = []
        self._unsubscribers: list[Callable[[], Any]] = []
        # Messages come from the executor and from the threads of the other nodes.
        self._callback_lock = threading.Lock()

    def add(
        self,
        topic: str,
        message_type: type,
        callback: Callable[[Any], None],
        qos: QoSProfile | None = None,
    ) -> None:
        """Add a topic that is subscribed to whenever the inputs are open.

        Without a profile it is best effort, and only the newest message is kept.
        """
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

        def locked(message: Any) -> None:
            with self._callback_lock:
                callback(message)

        self._topics.append((topic, message_type, locked, qos or newest))

    @property
    def are_open(self) -> bool:
        """Whether the node is subscribed."""
        return bool(self._unsubscribers)

    def open(self) -> None:
        """Subscribe to all topics, or to none if that fails.

        Raises
        ------
        InputError
            If a QoS override cannot be met.
        """
        with ExitStack() as undo:
            undo.callback(self.close)
            for topic, message_type, callback, qos in self._topics:
                name = self._node.resolve_topic_name(topic)
                if self._local is not None and self._local.offers(name):
                    self._unsubscribers.append(self._local.subscribe(name, callback))
                    continue
                with _readable_qos_errors(topic):
                    subscription = self._node.create_subscription(
                        message_type, topic, callback, qos, qos_overriding_options=_OVERRIDABLE
                    )
                destroy = partial(self._node.destroy_subscription, subscription)
                self._unsubscribers.append(destroy)
            undo.pop_all()

    def close(self) -> None:
        """End the subscriptions."""
        unsubscribers, self._unsubscribers = self._unsubscribers, []
        for unsubscribe in unsubscribers:
            unsubscribe()


@contextmanager
def _readable_qos_errors(topic: str) -> Iterator[None]:
    try:
        yield
    except (RuntimeError, ParameterException, InvalidQosOverridesError) as error:
        raise InputError(f"topic {topic}: {error}") from error
