"""Threads that share the work on one frame."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TypeVar

from coded_aperture_ros.core.errors import InputError

Item = TypeVar("Item")
First = TypeVar("First")
Second = TypeVar("Second")

# More of them than this share the work on one frame only if somebody says so.
_AUTOMATIC_THREADS = 4


class Workers:
    """Runs a function on many items in a fixed number of threads.

    NumPy and OpenCV let other threads run while they compute, so that plain threads suffice as
    long as each call has enough to do. The numerical libraries themselves should use one thread
    each beside this (``OPENBLAS_NUM_THREADS=1``, which the nodes and the command line set). Raises
    `InputError` if there are fewer processors. There are at most as many `threads` as processors,
    and the calling thread is one of them. What they run must not ask the same workers for more.
    """

    def __init__(self, threads: int = 1) -> None:
        check_threads(threads)
        self.threads = threads
        self._others = ThreadPoolExecutor(threads - 1, "engine") if threads > 1 else None

    def each(
        self, work: Callable[[Item, int], None], items: Sequence[Item], *, sums: bool = False
    ) -> None:
        """Call ``work(item, thread)`` for every item; `thread` counts from 0.

        No two calls with the same `thread` overlap, so that it can choose among buffers. With
        `sums` the same items always go to the same thread: what is added up in the order of the
        calls would otherwise differ in its last digits.
        """
        if self._others is None:
            for item in items:
                work(item, 0)
            return

        # Whoever is free takes the next: processors are not always equally fast.
        remaining = iter(items)

        def share(thread: int) -> None:
            for item in items[thread :: self.threads] if sums else remaining:
                work(item, thread)

        others = [self._others.submit(share, thread) for thread in range(1, self.threads)]
        try:
            share(0)
        finally:
            wait(others)  # buffers are theirs until then
        for other in others:
            other.result()

    def both(
        self, first: Callable[[], First], second: Callable[[], Second]
    ) -> tuple[First, Second]:
        """Call two functions, in two threads if there are; return what they return."""
        if self._others is None:
            return first(), second()
        other = self._others.submit(second)
        try:
            found = first()
        finally:
            wait([other])
        return found, other.result()

    def close(self) -> None:
        """End the threads."""
        if self._others is not None:
            self._others.shutdown()


def processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_threads(threads: int) -> None:
    """Refuse more threads than there are processors, by an `InputError`."""
    available = processors()
    if not 1 <= threads <= available:
        raise InputError(
            f"threads: {threads} is out of range: this machine has {available} processor(s) to "
            f"work with, use at most {available}"
        )


def thread_count(threads: int) -> int:
    """Return how many threads a setting means on this machine; 0: all processors, four at most.

    Raises `InputError` if there are fewer processors.
    """
    threads = threads or min(processors(), _AUTOMATIC_THREADS)
    check_threads(threads)
    return threads
