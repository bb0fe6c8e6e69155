"""Threads that share the work on one frame."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TypeVar

from coded_aperture_ros.core.errors import InputError

Item = TypeVar("Item")
First = TypeVar("First")
Second = TypeVar("Second")

# Most threads that are used unless a setting asks for more.
_AUTOMATIC_THREADS = 4


class Workers:
    """Fixed number of threads that run a function on many items.

    NumPy and OpenCV release Python's global lock while they compute, so that plain threads suffice
    as long as each call has enough to do. The numerical libraries themselves should use one thread
    each (``OPENBLAS_NUM_THREADS=1``, which the nodes and the command line set). A function that
    workers run must not call the same workers.

    Parameters
    ----------
    threads : int
        Number of threads, with the calling one; at most the number of processors.

    Raises
    ------
    InputError
        If there are fewer processors.

    Examples
    --------
    >>> workers = Workers(threads=1)
    >>> squares = {}
    >>> workers.each(lambda item, thread: squares.update({item: item**2}), [1, 2, 3])
    >>> squares
    {1: 1, 2: 4, 3: 9}
    >>> workers.close()
    """

    def __init__(self, threads: int = 1) -> None:
        check_threads(threads)
        self.threads = threads
        self._pool: ThreadPoolExecutor | None = None

    @property
    def _others(self) -> ThreadPoolExecutor | None:
        """Further threads, which begin with the first work, also after `close`; None: none."""
        if self._pool is None and self.threads > 1:
            self._pool = ThreadPoolExecutor(self.threads - 1, "engine")
        return self._pool

    def each(
        self, work: Callable[[Item, int], None], items: Sequence[Item], *, sums: bool = False
    ) -> None:
        """Call ``work(item, thread)`` for every item; `thread` counts from 0.

        Parameters
        ----------
        work : callable
            Calls with the same `thread` do not overlap, so that it can choose among buffers.
        items : sequence
        sums : bool
            Static scheduling: the same items always go to the same thread. Needed where results
            are added up, which would otherwise differ in their last digits.
        """
        pool = self._others
        if pool is None:
            for item in items:
                work(item, 0)
            return

        # Dynamic scheduling: processors are not always equally fast.
        remaining = iter(items)

        def share(thread: int) -> None:
            for item in items[thread :: self.threads] if sums else remaining:
                work(item, thread)

        others = [pool.submit(share, thread) for thread in range(1, self.threads)]
        try:
            share(0)
        finally:
            wait(others)  # they use the buffers until then
        for other in others:
            other.result()

    def both(
        self, first: Callable[[], First], second: Callable[[], Second]
    ) -> tuple[First, Second]:
        """Results of two functions, called in two threads if there are as many."""
        pool = self._others
        if pool is None:
            return first(), second()
        other = pool.submit(second)
        try:
            found = first()
        finally:
            wait([other])
        return found, other.result()

    def close(self) -> None:
        """End the threads; further work would begin new ones."""
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown()


def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_threads(threads: int) -> None:
    """Raise an `InputError` if there are fewer processors than threads."""
    available = processors()
    if not 1 <= threads <= available:
        raise InputError(
            f"threads: {threads} is out of range: this machine has {available} processor(s), "
            f"use at most {available}"
        )


def thread_count(threads: int) -> int:
    """Number of threads for a setting; 0: all processors, at most 4.

    Raises
    ------
    InputError
        If there are fewer processors.
    """
    threads = threads or min(processors(), _AUTOMATIC_THREADS)
    check_threads(threads)
    return threads
