"""Frames in time: no more than so many per second, and recorded ones as they were taken."""

import threading
import time
from collections.abc import Callable

# A recording in which the camera paused is not waited for as long as that.
_LONGEST_PAUSE_NS = 2_000_000_000


class RateLimit:
    """Decides which frames to take, so that their rate stays below a limit.

    Frames are due at even intervals: a late one does not delay those after it, and a pause does
    not allow a burst. `now` is a clock in seconds.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._due_s = 0.0

    def takes(self, rate_hz: float) -> bool:
        """Return whether to take the frame that has come now; always if the limit is 0."""
        now_s = self._now()
        if rate_hz <= 0:
            return True
        period_s = 1.0 / rate_hz
        self._due_s = min(self._due_s, now_s + period_s)  # the limit may have been lower before
        if now_s < self._due_s:
            return False
        self._due_s = max(self._due_s, now_s - period_s) + period_s
        return True


class Pace:
    """Waits until the next frame is due, by a steady clock; a late frame delays none after it.

    The event `stopping` ends every wait.
    """

    def __init__(self, stopping: threading.Event) -> None:
        self._stopping = stopping
        self.begin()

    def begin(self) -> None:
        """Take the next frame for the first: it is due at once."""
        self._due_s = time.monotonic()
        self._last_ns: int | None = None
        self._first = True

    def wait(self, period_s: float, stamp_ns: int | None = None) -> None:
        """Wait for the time of a frame, by its stamp or `period_s` after the one before."""
        if stamp_ns is not None and self._last_ns is not None:
            since_ns = stamp_ns - self._last_ns
            if 0 <= since_ns <= _LONGEST_PAUSE_NS:  # else it begins again, or paused
                period_s = since_ns * 1e-9
        self._last_ns = stamp_ns
        if self._first:
            self._first = False
            return
        self._due_s = max(self._due_s + period_s, time.monotonic())
        self._stopping.wait(self._due_s - time.monotonic())
