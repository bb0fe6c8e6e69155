"""Work shared by processes, for items that take long."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.connection import wait
from typing import Any, TypeVar

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import progress

Item = TypeVar("Item")
Result = TypeVar("Result")

# A process that has ended so long ago was not noticed by its pool.
_NOTICED_S = 3.0


class ProcessPool(ProcessPoolExecutor):
    """Pool of new processes that breaks whenever one of them is lost.

    Parameters
    ----------
    jobs : int
        Number of processes.
    set_up : callable, optional
        Called in each process first, with `arguments`.
    """

    def __init__(
        self, jobs: int, set_up: Callable[..., None] | None = None, arguments: tuple[Any, ...] = ()
    ) -> None:
        # A forked process would inherit the locks of libraries' threads, but not the threads.
        super().__init__(jobs, multiprocessing.get_context("spawn"), set_up, arguments)
        self._watched = False

    def submit(self, work: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        """Have work done in a process, as of `ProcessPoolExecutor`."""
        future = super().submit(work, *given, **named)
        if not self._watched:  # it begins with its first task
            self._watched = True
            break_with_lost_process(self)
        return future


def map_in_processes(
    work: Callable[[Item], Result], items: Sequence[Item], jobs: int, unit: str
) -> list[Result]:
    """Result for every item, in order, with a progress bar.

    Parameters
    ----------
    work : callable
        Function of a module, so that another process can import it.
    items : sequence
        Its argument, one for each call.
    jobs : int
        Number of processes; with 1 everything runs in this one.
    unit : str
        Word for an item beside the progress bar.

    Raises
    ------
    InputError
        If a process dies.
    """
    jobs = min(jobs, len(items))
    if jobs <= 1:
        return [work(item) for item in progress(items, len(items), unit)]
    with ProcessPool(jobs, _set_up) as pool:
        try:
            with _interrupts_wait():
                futures = [pool.submit(work, item) for item in items]
            for future in progress(as_completed(futures), len(futures), unit):
                future.result()  # the first error ends the run
        except BrokenProcessPool as error:
            raise InputError(
                "a process died, perhaps for lack of memory: use fewer --jobs"
            ) from error
        except BaseException:
            # Items take minutes: end those in work. The pool's thread then ends by itself: were it
            # still at work when Python exits, both would close the same pipe.
            for process in multiprocessing.active_children():
                process.terminate()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return [future.result() for future in futures]


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Block SIGINT while processes start: they inherit it, and leave Ctrl-C to this process.

    A terminal sends Ctrl-C to all of them. One that comes meanwhile is delivered right after.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def break_with_lost_process(pool: Any) -> None:
    """Let a pool break, too, when one of its processes is killed while it sends a result.

    By itself the pool's thread waits for the rest of the result, and never asks whether the process
    is still there.

    Parameters
    ----------
    pool : ProcessPoolExecutor
        Of Python or of loky, begun.
    """
    thread, processes, results = pool._executor_manager_thread, pool._processes, pool._result_queue

    def watch() -> None:
        ended: set[int] = set()
        while thread.is_alive():
            before = ended
            thread.join(_NOTICED_S)
            started = {process.sentinel: pid for pid, process in list(processes.items())}
            ended = {started[sentinel] for sentinel in wait(list(started), 0)}
            if ended & before:
                for pid in set(started.values()) - ended:
                    with suppress(ProcessLookupError):  # it has ended meanwhile
                        os.kill(pid, signal.SIGKILL)  # processes of loky have no `kill`
                results._writer.close()  # the last one: the thread reads the end of the results
                return

    threading.Thread(target=watch, daemon=True).start()


def end_with_program() -> None:
    """Let this process of a pool end when its program has ended, even if that was killed."""
    program = multiprocessing.parent_process()
    if program is None:  # it is the program itself
        return

    def wait() -> None:
        program.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _set_up() -> None:
    """Let OpenCV use one thread; BLAS has read its environment, set by `coded_aperture`."""
    import cv2

    end_with_program()
    cv2.setNumThreads(1)
