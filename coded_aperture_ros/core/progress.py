"""Progress of what takes long: as a callback, and as a bar on a terminal."""

import sys
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
