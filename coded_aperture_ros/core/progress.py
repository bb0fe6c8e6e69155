"""Progress callbacks, progress bars on a terminal, and the times of the parts of the work."""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

# Progress callback: takes the steps of long work, and yields them one by one; `iter` shows nothing.
Progress = Callable[[Iterable[Any]], Iterable[Any]]

# Shorter work has no progress bar.
_BAR_DELAY_S = 2.0
_DEFAULT_COLUMNS = 80
_DEFAULT_LINES = 24


def progress(items: Iterable[Any], total: int | None = None, unit: str = "it") -> Iterable[Any]:
    """`items`, with a progress bar on stderr if that is a terminal; it appears after 2 s.

    It does so during the first item, too: one item may take minutes.

    Parameters
    ----------
    items : iterable
    total : int, optional
        Number of items, if `items` has no length.
    unit : str
        Word for an item.
    """
    return _with_bar(items, total, unit) if sys.stderr.isatty() else items


def _with_bar(items: Iterable[Any], total: int | None, unit: str) -> Iterator[Any]:
    from tqdm import tqdm

    # Terminals of containers and of programs may say that they have no lines and no columns; tqdm
    # then shows nothing.
    size = os.get_terminal_size(sys.stderr.fileno())
    with tqdm(
        items,
        total=total,
        unit=unit,
        delay=_BAR_DELAY_S,
        leave=False,
        ncols=size.columns or _DEFAULT_COLUMNS,
        nrows=size.lines or _DEFAULT_LINES,
    ) as bar:

        def show() -> None:
            bar.delay = 0  # a bar that has been shown is cleared at the end
            bar.refresh()

        # By itself tqdm shows no bar before the first item is done.
        first = threading.Timer(_BAR_DELAY_S, show)
        first.daemon = True
        first.start()
        try:
            yield from bar
        finally:
            first.cancel()


class LapTimer:
    """Times of the parts of one frame's work, in order.

    The first part begins when the timer is made.

    Attributes
    ----------
    seconds : dict of str to float
        Time of every part, by its name, s.

    Examples
    --------
    >>> timer = LapTimer()
    >>> timer.lap("observe")
    >>> timer.lap("decode")
    >>> list(timer.seconds)
    ['observe', 'decode']
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last_s = time.perf_counter()

    def lap(self, part: str) -> None:
        """End a part: the time since the last lap is added to its time."""
        now = time.perf_counter()
        self.seconds[part] = self.seconds.get(part, 0.0) + now - self._last_s
        self._last_s = now
