"""Processes that work on the frames of a bag side by side.

Threads of one process got in each other's way: two processors did 1.1 times as many frames as one,
two processes do 1.9 times as many.
"""

import ctypes
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

import cv2

from coded_aperture_ros.bags.work import FrameResult, FrameWork
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.threads import processors

_PR_SET_PDEATHSIG = 1
# So long a process waits before it says that it is ready, so that another one answers too.
_EACH_S = 0.01

_work: FrameWork | None = None

Submit = Callable[[bytes], "Future[FrameResult]"]


def use_fork_server() -> None:
    """Let the process begin to load that others are forked from; the sooner, the less is waited."""
    from multiprocessing import forkserver

    multiprocessing.set_forkserver_preload([__name__])
    forkserver.ensure_running()


@contextmanager
def working(work: FrameWork, first: bytes) -> Iterator[Submit]:
    """Yield what has work done on messages, in as many processes as there are processors.

    With a memory of frames the work is that of one process, in the order of the frames; with one
    processor, of a thread of this process.

    Parameters
    ----------
    work : FrameWork
    first : bytes
        Message of a frame, to prepare with.

    Raises
    ------
    InputError
        If a process ended by itself.
    """
    if processors() == 1:
        work.prepare(first)
        with ThreadPoolExecutor(1, "bag") as pool:
            yield lambda data: pool.submit(work, data)
        return
    count = 1 if work.remembers else processors()
    use_fork_server()
    # A plain fork would inherit the locks of libraries' threads, but not the threads.
    context = multiprocessing.get_context("forkserver")
    with ProcessPoolExecutor(count, context, _begin, (work, first)) as pool:
        try:
            ready: set[int] = set()
            while len(ready) < count:
                ready |= {future.result() for future in [pool.submit(_ready) for _ in range(count)]}
            yield lambda data: pool.submit(_work_on, data)
        except BrokenProcessPool as error:
            raise InputError(
                "a process that worked on frames ended by itself, perhaps for lack of memory"
            ) from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _begin(work: FrameWork, first: bytes) -> None:
    """Begin to be one of the processes."""
    global _work
    # A terminal sends Ctrl-C to all processes: the first one answers it for them. And whatever
    # happens to it, none of them stays.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    cv2.setNumThreads(1)
    work.prepare(first)
    _work = work


def _ready() -> int:
    time.sleep(_EACH_S)
    return os.getpid()


def _work_on(data: bytes) -> FrameResult:
    assert _work is not None
    return _work(data)
