"""Who does the work of a search: processes of this machine, or the workers of a Dask scheduler."""

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

from coded_aperture_ros.core.errors import InputError

RunAll = Callable[[list[tuple[Any, ...]]], list[Any]]


@contextmanager
def local_processes(jobs: int) -> Iterator[RunAll]:
    """Yield what runs the epochs of all islands in processes; with one job, in this one.

    An `InputError` where a process ended by itself.
    """
    if jobs == 1:
        yield lambda tasks: [_run(task) for task in tasks]
        return
    # A forked process would inherit the locks of libraries' threads, but not the threads.
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"))
    try:
        yield lambda tasks: list(pool.map(_run, tasks))
    except BrokenProcessPool as error:
        raise InputError(
            "a process of the search ended by itself, perhaps for lack of memory: use fewer "
            "--jobs; with --checkpoint the search goes on where it stood"
        ) from error
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


@contextmanager
def dask_workers(address: str) -> Iterator[RunAll]:
    """Yield what runs the epochs of all islands on the workers of a Dask scheduler.

    A worker that dies loses nothing: an epoch depends only on its arguments, which this process
    keeps, and the scheduler gives it to another worker. An `InputError` where Dask is missing, or
    no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "--scheduler needs Dask: pip install 'coded_aperture_ros[cluster]'"
        ) from error
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there: start one with "
            "'dask scheduler', and workers with 'dask worker ADDRESS'"
        ) from error
    try:
        yield lambda tasks: client.gather(client.map(_run, tasks, pure=False, retries=2))
    finally:
        client.close()


def _run(task: tuple[Any, ...]) -> Any:
    from coded_aperture_ros.mask_design.search import run_epoch

    return run_epoch(*task)
