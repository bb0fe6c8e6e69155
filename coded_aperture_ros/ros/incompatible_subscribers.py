"""Warnings of subscribers that a node's publishers cannot serve."""

from collections.abc import Mapping
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible

_PERIOD_S = 1.0


class IncompatibleSubscribers:
    """Looks once a second for subscribers whose QoS a publisher cannot meet, and logs each once.

    rclpy has two event handlers for every publisher that would say so. Each of them is put into the
    executor's wait set anew for every message that comes: those of `depth_node` took 0.2 ms twice a
    frame.

    Parameters
    ----------
    node : Node
    publishers : mapping of str to Publisher
        By topic, as it is called in the log.
    """

    def __init__(self, node: Node, publishers: Mapping[str, Any]) -> None:
        self._node = node
        self._publishers = dict(publishers)
        self._known: set[bytes] = set()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_PERIOD_S, self._warn, clock=steady)

    def find(self) -> list[str]:
        """Lines about subscribers that have come since the last call and get nothing."""
        lines = []
        known, self._known = self._known, set()
        for topic, publisher in self._publishers.items():
            subscribers = self._node.get_subscriptions_info_by_topic(publisher.topic_name)
            offered = self._offered(publisher.topic_name) if subscribers else None
            for subscriber in subscribers if offered else ():
                compatible, reason = qos_check_compatible(offered, subscriber.qos_profile)
                if compatible != QoSCompatibility.ERROR:
                    continue
                endpoint = bytes(subscriber.endpoint_gid)
                self._known.add(endpoint)
                if endpoint not in known:
                    lines.append(
                        f"{topic}: {subscriber.node_name} subscribes with a QoS that gets no "
                        f"messages: {reason.strip(' ;')}"
                    )
        return lines

    def _offered(self, topic: str) -> QoSProfile | None:
        """QoS of the node's publisher, as the middleware has filled it in."""
        own = self._node.get_name(), self._node.get_namespace()
        for publisher in self._node.get_publishers_info_by_topic(topic):
            if (publisher.node_name, publisher.node_namespace) == own:
                return publisher.qos_profile
        return None

    def close(self) -> None:
        """Stop looking."""
        self._node.destroy_timer(self._timer)

    def _warn(self) -> None:
        for line in self.find():
            self._node.get_logger().warning(line)
