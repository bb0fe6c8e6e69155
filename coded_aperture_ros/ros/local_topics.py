"""Topics whose messages stay inside a process, for nodes that run in one."""

import threading
from collections.abc import Callable
from typing import Any


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
