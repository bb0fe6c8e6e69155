"""Shards of frames, computed here or by the workers of a Dask scheduler, and kept on disk."""

import argparse
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_ros.core.cluster import dask_client

Arrays = dict[str, np.ndarray]
Task = tuple[Any, ...]


def shards_of(pairs: Sequence[int]) -> list[int]:
    """Return the shards from each first one to before each last one."""
    return [
        shard
        for first, last in zip(pairs[::2], pairs[1::2], strict=True)
        for shard in range(first, last)
    ]


def add_shard_options(parser: argparse.ArgumentParser) -> None:
    """Add what all scripts that compute shards have in common."""
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--shards", type=int, nargs="+", required=True, help="FIRST END [STEP]")
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask scheduler whose workers share the shards, instead of this process",
    )


def compute(
    function: Callable[..., Arrays],
    tasks: Iterable[tuple[Path, Callable[[], Task]]],
    modules: tuple[str, ...],
    scheduler: str | None,
) -> None:
    """Write the shards that are not there yet, and a line for each.

    Parameters
    ----------
    function : callable
        From a task to arrays. Of a module beside this one, so that workers can import it.
    tasks : iterable of (Path, callable)
        Where a shard is written, and what reads the arguments of the function.
    modules : tuple of str
        Files beside this one that workers need.
    scheduler : str or None
        Address of a Dask scheduler. Workers need this package, and no common disk.
    """
    missing = [(path, read) for path, read in tasks if not path.exists()]
    start = time.perf_counter()
    computed = _on_workers if scheduler else _here
    for number, (path, arrays) in enumerate(computed(function, missing, modules, scheduler), 1):
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part.npz")
        np.savez(part, **arrays)
        part.rename(path)
        spent = time.perf_counter() - start
        left = spent / number * (len(missing) - number)
        print(
            f"{path.name}: {number} of {len(missing)}, {spent / 60:.1f} min, "
            f"{left / 60:.0f} min left",
            flush=True,
        )


def _here(function: Callable[..., Arrays], missing: list, *_: Any) -> Iterator[tuple[Path, Arrays]]:
    for path, read in missing:
        yield path, function(*read())


def _on_workers(
    function: Callable[..., Arrays], missing: list, modules: tuple[str, ...], address: str
) -> Iterator[tuple[Path, Arrays]]:
    """Yield shards as they come; a worker that dies loses nothing but time."""
    from distributed import as_completed

    files = [str(Path(__file__).with_name(name)) for name in modules]
    with dask_client(address) as client:
        for file in files:
            client.upload_file(file)
        waiting = iter(missing)
        paths = {}
        done = as_completed()

        def submit() -> None:
            for path, read in waiting:
                future = client.submit(function, *read(), pure=False, retries=2)
                paths[future.key] = path
                done.add(future)
                return

        # Two for each thread, so that none waits; not all, for their arguments take memory.
        for _ in range(max(2 * sum(client.nthreads().values()), 1)):
            submit()
        for future in done:
            yield paths[future.key], future.result()
            future.release()
            submit()
