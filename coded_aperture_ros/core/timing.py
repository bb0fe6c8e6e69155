"""How long the parts of the work on a frame take."""

import time


class LapTimer:
    """Times of the parts of one frame's work, in the order in which they were done.

    The first part begins with the timer.

    Attributes
    ----------
    seconds : dict of str to float
        Time of every part, by its name.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last_s = time.perf_counter()

    def lap(self, part: str) -> None:
        """End a part: the time since the last lap adds to what it has taken so far."""
        now = time.perf_counter()
        self.seconds[part] = self.seconds.get(part, 0.0) + now - self._last_s
        self._last_s = now

    def skip(self) -> None:
        """Count the time since the last lap to no part."""
        self._last_s = time.perf_counter()
