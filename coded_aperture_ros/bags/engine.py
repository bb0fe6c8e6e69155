"""Work on the frames of a bag, or on whole bags, by worker processes that joblib runs.

`in_order` is the one engine: tasks are frames of one bag or bags, the processes are those of this
machine or of a Dask cluster. What a worker needs for a task, it keeps for the next one; see
`bags.frames.kept_processor`.

Processes, because threads of one process got in each other's way: two processors did 1.2 times as
many frames as one, two processes do 1.9 times as many.
"""

import functools
import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import islice, starmap
from typing import Any, TypeVar

import cv2

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.processes import break_with_lost_process
from coded_aperture_ros.core.workers import processors

Item = TypeVar("Item")
Argument = TypeVar("Argument")
Result = TypeVar("Result")

# Period of a worker's check whether its program is still there.
_PARENT_CHECK_S = 0.5
# The threads that hand tasks to workers end within this when there are no workers.
_FEEDER_END_S = 2.0


class WorkerLostError(InputError):
    """A worker process ended in the middle of a task."""


def in_order(
    work: Callable[[Argument], Result],
    tasks: Iterable[tuple[Item, Argument | None]],
    *,
    processes: int,
    window: int,
    client: Any = None,
) -> Generator[tuple[Item, Result | None], None, None]:
    """Items with the results of their tasks, in the order of the tasks.

    Parameters
    ----------
    work : callable
        Called as ``work(argument)`` by a worker; pickled, like arguments and results.
    tasks : iterable of (item, argument)
        The item stays here. An argument of None: there is nothing to do, and the result is None.
    processes : int
        Worker processes of this machine; 1: the work is done in this one, task by task.
    window : int
        Tasks whose results are in memory at once, at most. The next ones are taken when all of
        these are done: a small multiple of `processes` keeps them busy.
    client : distributed.Client, optional
        Of a Dask cluster, whose workers take the place of processes.

    Yields
    ------
    (item, result)

    Raises
    ------
    WorkerLostError
        If a worker ended by itself. What `work` raises comes out, too; workers are ended then.
    """
    if client is None and processes == 1:
        yield from _one_ahead(work, tasks)
        return
    if client is None:
        work = _for_this_program(work, processes)
    tasks = iter(tasks)
    with _parallel(processes, client) as parallel:
        while part := list(islice(tasks, window)):
            arguments = [argument for _, argument in part if argument is not None]
            with _begun(parallel, work, arguments) as results:
                for item, argument in part:
                    yield item, None if argument is None else next(results)
                # joblib ends a call when its generator has ended.
                for _ in results:
                    pass


@contextmanager
def workers_starting(processes: int, module: str) -> Iterator[None]:
    """Let worker processes start and import a module meanwhile; at the end they have done so.

    That takes a second or two. With one process nothing is started.
    """
    if processes == 1:
        yield
        return
    load = _for_this_program(_load, processes)
    with _parallel(processes) as parallel, _begun(parallel, load, [module] * processes) as loaded:
        yield
        for _ in loaded:
            pass


def _one_ahead(
    work: Callable[[Argument], Result], tasks: Iterable[tuple[Item, Argument | None]]
) -> Iterator[tuple[Item, Result | None]]:
    """Do tasks one by one in a thread, each while the result of the one before is used here.

    Reading and writing beside the work makes a sixth more frames a second.
    """
    with ThreadPoolExecutor(1) as thread:
        begun: deque[tuple[Item, Future[Result] | None]] = deque()
        for item, argument in tasks:
            begun.append((item, None if argument is None else thread.submit(work, argument)))
            if len(begun) > 1:
                yield _finished(*begun.popleft())
        yield from starmap(_finished, begun)


def _finished(item: Item, result: "Future[Any] | None") -> tuple[Item, Any]:
    return item, None if result is None else result.result()


@contextmanager
def _parallel(processes: int, client: Any = None) -> Iterator[Any]:
    """Yield a `joblib.Parallel` whose results come from a generator."""
    try:
        from joblib import Parallel, parallel_config
    except ImportError as error:
        raise InputError("bags need joblib: pip install joblib") from error
    # Arrays are not put into shared files: what comes of a frame is read once.
    options = {"return_as": "generator", "batch_size": 1, "max_nbytes": None}
    if client is None:
        _start_silent_tracker()
        with _naming_lost_workers():
            # Not as a context: interrupted, that would begin anew, and leave a folder behind.
            yield Parallel(n_jobs=processes, backend=_worker_processes(), **options)
        return
    client.wait_for_workers(1)
    with _naming_lost_workers(), parallel_config(backend="dask", client=client):
        try:
            parallel = Parallel(n_jobs=-1, pre_dispatch="all", **options)
        except ValueError:  # joblib before 1.4 gives Dask's results all at the end
            parallel = Parallel(n_jobs=-1, pre_dispatch="all", **options | {"return_as": "list"})
        yield parallel


def _start_silent_tracker() -> None:
    """Start the process that removes what a program leaves behind that is ended at any moment.

    By itself it says on stderr what that was, after the program has ended.
    """
    from joblib.externals.loky.backend import resource_tracker

    sys.warnoptions.append("ignore:resource_tracker")
    try:
        resource_tracker.ensure_running()
    finally:
        sys.warnoptions.pop()


def _worker_processes() -> Any:
    """Return joblib's worker processes: their end is noticed always, and prints nothing."""
    from joblib.parallel import BACKENDS

    loky: Any = BACKENDS["loky"]

    class Workers(loky):
        _watched: Any = None

        def configure(self, *args: Any, **kwargs: Any) -> int:
            count: int = super().configure(*args, **kwargs)
            self._workers._ensure_executor_running()
            if self._watched is not self._workers:
                self._watched = self._workers
                break_with_lost_process(self._workers)
            return count

        def abort_everything(self, ensure_ready: bool = True) -> None:
            # Asked to end them, loky forgets the tasks that wait, and its thread fails with a
            # KeyError if it takes one just then. When they have ended, it forgets them in order.
            with suppress(RuntimeError):  # they have ended by themselves
                endless = self._workers.submit(time.sleep, 1e6)
                for process in multiprocessing.active_children():
                    if "loky" in type(process).__module__:
                        process.terminate()
                endless.exception()
            super().abort_everything(ensure_ready=ensure_ready)
            # A program that ends before these threads leaves locks behind, which are complained of.
            for thread in threading.enumerate():
                if thread.name == "QueueFeederThread":
                    thread.join(_FEEDER_END_S)

    return Workers()


@contextmanager
def _begun(
    parallel: Any, work: Callable[[Argument], Result], arguments: Iterable[Argument]
) -> Iterator[Iterator[Result]]:
    """Results of tasks that have begun; workers are ended if not all results are taken."""
    from joblib import delayed

    results = parallel(delayed(work)(argument) for argument in arguments)
    try:
        yield iter(results)
    finally:
        if isinstance(results, Generator):
            with warnings.catch_warnings():
                # It counts the tasks that are not finished.
                warnings.simplefilter("ignore", UserWarning)
                results.close()


@contextmanager
def _naming_lost_workers() -> Iterator[None]:
    """Raise `WorkerLostError` in place of what joblib and Dask raise."""
    try:
        yield
    except BrokenProcessPool as error:
        raise WorkerLostError(
            "a process that worked on frames ended by itself, perhaps for lack of memory"
        ) from error
    except Exception as error:
        if type(error).__name__ != "KilledWorker":  # of distributed, which need not be there
            raise
        raise WorkerLostError(
            "its worker died, several times: perhaps for lack of memory"
        ) from error


def _load(module: str) -> None:
    import_module(module)


def _for_this_program(
    work: Callable[[Argument], Result], processes: int
) -> Callable[[Argument], Result]:
    """Return a function that sets up a worker of this program before it works."""
    threads = max(1, processors() // processes)
    return functools.partial(_set_up_and_work, work, os.getpid(), threads)


def _set_up_and_work(
    work: Callable[[Argument], Result], parent: int, threads: int, argument: Argument
) -> Result:
    _set_up(parent, threads)
    return work(argument)


@functools.cache
def _set_up(parent: int, threads: int) -> None:
    """Set up a worker process, with its first task."""
    # A terminal sends Ctrl-C to all processes: the program answers it for them.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(threads)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process when the program that has started it is killed."""
    while os.getppid() == parent:
        time.sleep(_PARENT_CHECK_S)
    os._exit(1)
