"""Work in several threads whose results come in the order of the items."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], threads: int, ahead: int
) -> Iterator[Result]:
    """Yield ``work(item)`` for every item, in their order, while threads work on those that follow.

    Such iterators make a pipeline if the items of one are the results of another. With one thread
    the items are worked on one after the other.

    Parameters
    ----------
    work : callable
    items : iterable
        Gone through by whoever takes the results.
    threads : int
    ahead : int
        Items that are taken before the first of them is asked for, at most; bounds the memory.
    """
    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(threads, "bag") as pool:
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) >= ahead:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
