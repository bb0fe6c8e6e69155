"""A progress bar for what takes longer than two seconds, if someone watches."""

import sys
from collections.abc import Iterable
from typing import Any


def progress(items: Iterable[Any], total: int | None = None, unit: str = "it") -> Iterable[Any]:
    """Return `items`, with a progress bar on stderr if that is a terminal.

    Needs tqdm, which the extra `[eval]` installs; without it there is no bar.
    """
    if not sys.stderr.isatty():
        return items
    try:
        from tqdm import tqdm
    except ImportError:
        return items
    return tqdm(items, total=total, unit=unit, delay=2, leave=False)
