"""Work that is done side by side, and whose results come in the order of the items."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(
    begin: Callable[[Item], Callable[[], Result] | None], items: Iterable[Item], ahead: int
) -> Iterator[tuple[Item, Result | None]]:
    """Yield every item with its result, in their order, while others work on those that follow.

    Parameters
    ----------
    begin : callable
        Begins the work on an item, and returns what waits for the result; None: there is no work.
    items : iterable
        Gone through by whoever takes the results.
    ahead : int
        Items that are taken before the first of them is asked for, at most; bounds the memory.
    """
    waiting: deque[tuple[Item, Callable[[], Result] | None]] = deque()

    def first() -> tuple[Item, Result | None]:
        item, wait = waiting.popleft()
        return item, wait() if wait else None

    for item in items:
        waiting.append((item, begin(item)))
        if len(waiting) >= ahead:
            yield first()
    while waiting:
        yield first()
