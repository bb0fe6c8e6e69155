"""Publishing recorded frames as fast as they were taken."""

import threading
import time

# A recording in which the camera paused is not waited for as long as that.
_LONGEST_PAUSE_NS = 2_000_000_000


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
