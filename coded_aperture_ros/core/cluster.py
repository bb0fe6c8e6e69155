"""Clients of a Dask cluster."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

from coded_aperture_ros.core.errors import InputError


@contextmanager
def dask_client(address: str) -> Iterator[Any]:
    """Client of a Dask scheduler, closed at the end of the block.

    Parameters
    ----------
    address : str
        As given to `--scheduler`.

    Raises
    ------
    InputError
        If Dask is not installed, or no scheduler answers.
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
