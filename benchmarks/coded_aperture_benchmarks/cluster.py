"""The workers of a Dask scheduler, for what takes long."""

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

    `work` returns that, or nothing. What a worker that dies was at, another one begins anew.
    """
    with dask_client(address) as client:
        from distributed import KilledWorker, as_completed

        waiting = {client.submit(work, item, pure=False): item for item in items}
        for future in as_completed(waiting):
            try:
                yield waiting[future], future.result()
            except KilledWorker:
                yield waiting[future], "its worker died, several times: perhaps for lack of memory"
