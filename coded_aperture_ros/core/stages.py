"""How long the parts of the work on a frame take."""

import time
from collections.abc import Mapping


class Stages:
    """Times of the stages of one frame, in the order in which they were done; begins at once."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}  # time of every stage, by its name
        self._last_s = time.perf_counter()

    def lap(self, stage: str) -> None:
        """End a stage, or a part of one: what has passed since the last lap adds to its time."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last_s
        self._last_s = now

    def take(self, seconds: Mapping[str, float]) -> None:
        """Take over the stages of a part that has timed itself, just done."""
        self.seconds.update(seconds)
        self._last_s = time.perf_counter()
