"""Frame scheduling: work on the newest frame, at most at a rate; play recordings at their pace."""

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")

# Longest gap between two stamps that playback waits for: a camera that was paused while it
# recorded does not stop the playback for as long.
_LONGEST_GAP_NS = 2_000_000_000


class NewestWorker(Generic[Item]):
    """Thread that always works on the newest item offered.

    There is room for one waiting item. A newer one replaces it, and the replaced one is dropped:
    a node slower than its input lags by one item at most, and never builds up a queue.

    Parameters
    ----------
    work : callable
        Called with an item, in the worker's thread. It must not raise.
    dropped : callable
        Called whenever an item is replaced, in the thread that offers.
    name : str
        Name of the thread.
    begin : callable
        Called first, in the worker's thread. It must not raise.
    """

    def __init__(
        self,
        work: Callable[[Item], None],
        dropped: Callable[[], None],
        name: str = "worker",
        begin: Callable[[], None] = lambda: None,
    ) -> None:
        self._begin = begin
        self._work = work
        self._dropped = dropped
        self._change = threading.Condition()
        self._waiting: Item | None = None
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> None:
        """Replace the waiting item; return at once."""
        with self._change:
            replaced = self._waiting is not None
            self._waiting = item
            self._change.notify()
        if replaced:
            self._dropped()

    def stop(self, timeout_s: float | None = None) -> bool:
        """Drop the waiting item and wait for the one in work; return whether the thread has ended.

        With `timeout_s` it waits for so many seconds at most.
        """
        with self._change:
            self._stopping = True
            self._waiting = None
            self._change.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        self._begin()
        while True:
            with self._change:
                self._change.wait_for(lambda: self._stopping or self._waiting is not None)
                if self._stopping:
                    return
                item, self._waiting = self._waiting, None
            assert item is not None  # the condition above waits for it
            self._work(item)


class RateLimit:
    """Selection of frames such that their rate stays below a limit.

    Frames are due at even intervals: a late one does not delay those after it, and a pause does
    not allow a burst.

    Parameters
    ----------
    now : callable
        Clock, seconds.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._due_s = 0.0

    def takes(self, rate_hz: float) -> bool:
        """Whether to take the frame that has come now; always if the limit is 0."""
        now_s = self._now()
        if rate_hz <= 0:
            return True
        period_s = 1.0 / rate_hz
        self._due_s = min(self._due_s, now_s + period_s)  # the limit may have been lower before
        if now_s < self._due_s:
            return False
        self._due_s += period_s
        if self._due_s <= now_s:  # after a pause
            self._due_s = now_s + period_s
        return True


class Pace:
    """Playback pace: waits until the next frame is due, by a steady clock.

    A late frame does not delay those after it.

    Parameters
    ----------
    stopping : threading.Event
        Ends every wait once it is set.
    """

    def __init__(self, stopping: threading.Event) -> None:
        self._stopping = stopping
        self.begin()

    def begin(self) -> None:
        """Restart the clock: the next frame is due at once."""
        self._due_s = time.monotonic()
        self._last_ns: int | None = None
        self._first = True

    def wait(self, period_s: float, stamp_ns: int | None = None) -> None:
        """Wait until a frame is due: by its stamp, or `period_s` after the frame before."""
        if stamp_ns is not None and self._last_ns is not None:
            gap_ns = stamp_ns - self._last_ns
            if 0 <= gap_ns <= _LONGEST_GAP_NS:  # else the recording starts again, or was paused
                period_s = gap_ns * 1e-9
        self._last_ns = stamp_ns
        if self._first:
            self._first = False
            return
        self._due_s = max(self._due_s + period_s, time.monotonic())
        self._stopping.wait(self._due_s - time.monotonic())
