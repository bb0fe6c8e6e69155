"""How long the parts of the work on a frame take."""

import time


class Stages:
    """Times of the stages of one frame, in the order in which they were done.

    Attributes
    ----------
    seconds : dict
        Time of every stage of the frame that was begun last, by its name.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last_s = 0.0

    def start(self) -> None:
        """Begin a frame."""
        self.seconds = {}
        self._last_s = time.perf_counter()

    def lap(self, stage: str) -> None:
        """End a stage: what has passed since the last one ended is its time."""
        now = time.perf_counter()
        self.seconds[stage] = now - self._last_s
        self._last_s = now
