"""Processes that work on the frames of a bag side by side.

Threads of one process got in each other's way: two processors did 1.2 times as many frames as one,
two processes do 1.9 times as many.
"""

import contextlib
import dataclasses
import itertools
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, TypeVar

import cv2

from coded_aperture_ros.bags.frames import FrameProcessor, ProcessedFrame
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.workers import load_in_fork_server, processors, thread_count

Item = TypeVar("Item")
Result = TypeVar("Result")
Wait = Callable[[], ProcessedFrame]
Submit = Callable[[bytes], Wait]


def in_order(
    begin: Callable[[Item], Callable[[], Result] | None], items: Iterable[Item], ahead: int
) -> Iterator[tuple[Item, Result | None]]:
    """Yield every item with its result, in their order, while others work on those that follow.

    `begin` begins to process an item, and returns what waits for the result; None: there is none.
    At most `ahead` items are taken before the first of them is asked for, which bounds the memory.
    """
    waiting: deque[tuple[Item, Callable[[], Result] | None]] = deque()
    for item in items:
        waiting.append((item, begin(item)))
        if len(waiting) >= ahead:
            first, wait = waiting.popleft()
            yield first, wait() if wait else None
    for first, wait in waiting:
        yield first, wait() if wait else None


@contextmanager
def frame_workers(processor: FrameProcessor, first: bytes) -> Iterator[Submit]:
    """Yield what has a message of a frame processed, and returns what waits for the result.

    There are as many processes as processors, which take turns. If the pipeline remembers frames,
    there is one process, which takes them in their order; with one processor, it is this one.

    They prepare with the message `first`. An `InputError` if a process ended by itself.
    """
    if processors() == 1:
        processor.prepare(first)
        yield lambda data: lambda: processor(data)
        return
    load_in_fork_server(__name__)
    workers: list[_Worker] = []
    count = 1 if processor.pipeline.remembers else processors()
    config = processor.pipeline.estimator.config
    if count > 1 and not config.threads:  # every processor has its process
        processor.pipeline.reconfigure(depth=dataclasses.replace(config, threads=1))
    try:
        for _ in range(count):
            workers.append(_Worker(processor, first))
        for worker in workers:
            worker.wait()  # until it is ready
        turns = itertools.cycle(workers)
        yield lambda data: next(turns).begin(data)
    finally:
        for worker in workers:
            worker.end()


class _Worker:
    """A process that works on one message after the other; it may be given several."""

    def __init__(self, processor: FrameProcessor, first: bytes) -> None:
        # A plain fork would inherit the locks of libraries' threads, but not the threads.
        context = multiprocessing.get_context("forkserver")
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, processor, first), daemon=True)
        self._process.start()
        other.close()

    def begin(self, data: bytes) -> Wait:
        with _naming_its_end():
            self._connection.send_bytes(data)
        return self.wait

    def wait(self) -> ProcessedFrame:
        """Return the result of the first message that it has not been returned of."""
        with _naming_its_end():
            result = self._connection.recv()
        if isinstance(result, Exception):
            raise result
        return result

    def end(self) -> None:
        self._process.kill()
        self._process.join()
        self._connection.close()


@contextmanager
def _naming_its_end() -> Iterator[None]:
    try:
        yield
    except (EOFError, ConnectionError) as error:
        raise InputError(
            "a process that worked on frames ended by itself, perhaps for lack of memory"
        ) from error


def _serve(connection: Connection, processor: FrameProcessor, first: bytes) -> None:
    """Be one of the processes."""
    # A terminal sends Ctrl-C to all processes: the program answers it for them.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Beside others one thread is enough; who works alone shares the work on each frame.
    threads = processor.pipeline.estimator.config.threads if processor.pipeline.remembers else 1
    cv2.setNumThreads(thread_count(threads))
    messages: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_take, args=(connection, messages), daemon=True).start()
    answer: Any = None
    try:
        processor.prepare(first)
    except Exception as error:
        answer = error
    with contextlib.suppress(ConnectionError):  # the program has ended
        while True:
            connection.send(answer)
            try:
                answer = processor(messages.get())
            except Exception as error:
                answer = error


def _take(connection: Connection, messages: "SimpleQueue[bytes]") -> None:
    """Take messages as they come: who sends them does not wait, and may be killed."""
    try:
        while True:
            messages.put(connection.recv_bytes())
    except (EOFError, ConnectionError):
        os._exit(1)
