"""Pairing of the messages of two topics by their stamps."""

import math
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

First = TypeVar("First")
Second = TypeVar("Second")


class StampPairs(Generic[First, Second]):
    """Pairs messages of two topics by their exact stamps, in a bounded buffer.

    A pair drops everything older: stamps increase, and only the newest results are wanted. Safe to
    use from several threads.

    Parameters
    ----------
    capacity : int
        Most messages of each topic that wait.
    dropped : callable
        Called for every message of the first topic that is dropped without a partner.
    capacity_bytes : float
        Most bytes of each topic that wait; the newest message waits whatever its size.
    size_bytes : callable
        Size of a message.
    """

    def __init__(
        self,
        capacity: int,
        dropped: Callable[[], None],
        capacity_bytes: float = math.inf,
        size_bytes: Callable[[First | Second], int] = lambda _: 0,
    ) -> None:
        self._capacity = capacity
        self._dropped = dropped
        self._capacity_bytes = capacity_bytes
        self._size_bytes = size_bytes
        self._lock = threading.Lock()
        self._first: dict[int, First] = {}
        self._second: dict[int, Second] = {}

    def add(
        self, first: bool, stamp_ns: int, message: First | Second
    ) -> tuple[First, Second] | None:
        """Add a message of the first or the second topic; return the pair that it completes."""
        with self._lock:
            self._keep(self._first if first else self._second, stamp_ns, message)
            return self._pair(stamp_ns)

    def clear(self) -> None:
        """Drop everything that waits."""
        with self._lock:
            for waiting in (self._first, self._second):
                for stamp in list(waiting):
                    self._drop(waiting, stamp)

    def __len__(self) -> int:
        """Number of messages that wait for their partner."""
        return len(self._first) + len(self._second)

    def _keep(self, waiting: dict, stamp_ns: int, message: First | Second) -> None:
        waiting[stamp_ns] = message
        while len(waiting) > self._capacity or (
            len(waiting) > 1 and sum(map(self._size_bytes, waiting.values())) > self._capacity_bytes
        ):
            self._drop(waiting, next(iter(waiting)))  # the first that came

    def _pair(self, stamp_ns: int) -> tuple[First, Second] | None:
        if stamp_ns not in self._first or stamp_ns not in self._second:
            return None
        pair = self._first.pop(stamp_ns), self._second.pop(stamp_ns)
        for waiting in (self._first, self._second):
            for old in [stamp for stamp in waiting if stamp < stamp_ns]:
                self._drop(waiting, old)
        return pair

    def _drop(self, waiting: dict, stamp_ns: int) -> None:
        del waiting[stamp_ns]
        if waiting is self._first:
            self._dropped()
