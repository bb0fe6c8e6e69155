"""Progress of what takes long, as a callback and as a bar on a terminal; times of its parts."""

import sys
import time
from collections.abc import Callable, Iterable
from typing import Any

# Takes the steps of something that takes long, and yields them one by one; `iter` shows nothing.
Progress = Callable[[Iterable[Any]], Iterable[Any]]

_DELAY_S = 2


def progress(items: Iterable[Any], total: int | None = None, unit: str = "it") -> Iterable[Any]:
    """Return `items`, with a progress bar on stderr if that is a terminal, after two seconds."""
    if not sys.stderr.isatty():
        return items
    from tqdm import tqdm

    return tqdm(items, total=total, unit=unit, delay=_DELAY_S, leave=False)


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
