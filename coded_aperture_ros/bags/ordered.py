"""Work that is done side by side, and whose results come in the order of the items."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(
    submit: Callable[[Item], "Future[Result] | None"], items: Iterable[Item], ahead: int
) -> Iterator[tuple[Item, Result | None]]:
    """Yield every item with its result, in their order, while others work on those that follow.

    Parameters
    ----------
    submit : callable
        Has the work on an item done; None: there is none to do.
    items : iterable
        Gone through by whoever takes the results.
    ahead : int
        Items that are taken before the first of them is asked for, at most; bounds the memory.
    """
    waiting: deque[tuple[Item, Future[Result] | None]] = deque()

    def first() -> tuple[Item, Result | None]:
        item, future = waiting.popleft()
        return item, future.result() if future else None

    try:
        for item in items:
            waiting.append((item, submit(item)))
            if len(waiting) >= ahead:
                yield first()
        while waiting:
            yield first()
    finally:
        for _, future in waiting:
            if future:
                future.cancel()
