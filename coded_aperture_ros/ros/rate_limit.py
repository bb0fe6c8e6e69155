"""Taking only so many frames per second."""

import time
from collections.abc import Callable


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
        if now_s < self._due_s:
            return False
        period_s = 1.0 / rate_hz
        self._due_s = max(self._due_s, now_s - period_s) + period_s
        return True
