"""Processes that share work of which each piece takes long."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import progress

Item = TypeVar("Item")
Result = TypeVar("Result")


def map_in_processes(
    work: Callable[[Item], Result], items: Sequence[Item], jobs: int, unit: str
) -> list[Result]:
    """Return the result for every item, in order, with a progress bar.

    Parameters
    ----------
    work : callable
        A module's function, so that another process can import it.
    items : sequence
        What it is called with, one at a time.
    jobs : int
        Number of processes; with 1 all happens in this one.
    unit : str
        What an item is called beside the progress bar.

    Raises
    ------
    InputError
        If a process ends by itself.
    """
    jobs = min(jobs, len(items))
    if jobs <= 1:
        return [work(item) for item in progress(items, len(items), unit)]
    # A forked process would inherit the locks of libraries' threads, but not the threads.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, initializer=_use_one_thread) as pool:
        try:
            with _interrupts_wait():
                futures = [pool.submit(work, item) for item in items]
            for future in progress(as_completed(futures), len(futures), unit):
                future.result()  # the first error ends the run
        except BrokenProcessPool as error:
            raise InputError(
                "a process ended by itself, perhaps for lack of memory: use fewer --jobs"
            ) from error
        except BaseException:
            # Pieces take minutes: do not wait for those that are under way.
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise
    return [future.result() for future in futures]


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Start processes that take no Ctrl-C, which a terminal sends to all: we answer it for them.

    They inherit what is blocked. One that comes meanwhile is not lost: it is answered right after.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _use_one_thread() -> None:
    """Leave the other processors to the other processes.

    BLAS reads its environment, which `coded_aperture` has set, when NumPy is imported.
    """
    import cv2

    cv2.setNumThreads(1)
