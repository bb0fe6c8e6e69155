"""A progress bar for what takes longer than two seconds, if someone watches."""

import sys
from collections.abc import Iterable
from typing import Any

_DELAY_S = 2


def progress(items: Iterable[Any], total: int | None = None, unit: str = "it") -> Iterable[Any]:
    """Return `items`, with a progress bar on stderr if that is a terminal."""
    if not sys.stderr.isatty():
        return items
    from tqdm import tqdm

    return tqdm(items, total=total, unit=unit, delay=_DELAY_S, leave=False)
