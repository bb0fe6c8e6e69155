"""The workers of a Dask scheduler, for what takes long."""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from typing import Any, TypeVar

from coded_aperture_ros.core.errors import InputError

Item = TypeVar("Item")


@contextmanager
def dask_client(address: str) -> Iterator[Any]:
    """Yield a client of a Dask scheduler, as `--scheduler` names it.

    Raises `InputError` if Dask is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "--scheduler needs Dask: in the folder of the checkout, pip install '.[cluster]'"
        ) from error
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there: start one with "
            "'dask scheduler', and workers with 'dask worker ADDRESS'"
        ) from error
    with closing(client):
        yield client


def failures_on_workers(
    address: str, work: Callable[[Item], str], items: Iterable[Item]
) -> Iterator[tuple[Item, str]]:
    """Do work on a scheduler's workers; yield items as they are done, with what went wrong.

    `work` returns that, or nothing; both, and items, are pickled. What a worker that dies was at,
    another one begins anew.
    """
    with dask_client(address) as client:
        from distributed import KilledWorker, as_completed

        waiting = {client.submit(_apart, work, item, pure=False): item for item in items}
        for future in as_completed(waiting):
            try:
                yield waiting[future], future.result()
            except KilledWorker:
                yield waiting[future], "its worker died, several times: perhaps for lack of memory"


def _apart(work: Callable[[Item], str], item: Item) -> str:
    """Do work in a process of its own, as if it had been started here by hand.

    A worker must not have others below it, shares its libraries' threads among tasks, and hands all
    memory back at once, which takes half of the time of large arrays.
    """
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    environment |= {"OPENBLAS_NUM_THREADS": "1", "OPENCV_LOG_LEVEL": "SILENT"}
    environment.pop("MALLOC_TRIM_THRESHOLD_", None)
    program = [sys.executable, "-c", _PROGRAM]
    pipe = subprocess.PIPE
    with subprocess.Popen(program, stdin=pipe, stdout=pipe, env=environment) as process:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(pickle.dumps((work, item)))
        process.stdin.flush()  # and not closed: that would be our end
        answer = process.stdout.read().decode()
        process.wait()
    if process.returncode:
        return f"its process ended with status {process.returncode}, see the log of the worker"
    return answer


# It ends with who has started it.
_PROGRAM = """
import os, pickle, sys, threading
work, item = pickle.load(sys.stdin.buffer)
threading.Thread(target=lambda: os._exit(len(sys.stdin.buffer.read()) or 1), daemon=True).start()
print(work(item), end="", flush=True)
os._exit(0)
"""
