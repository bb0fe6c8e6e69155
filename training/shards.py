"""Data in shards: made by processes here or by the workers of a Dask scheduler, kept on disk."""

import dataclasses
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed, parallel_config

from coded_aperture_ros.core.cluster import dask_client

Arrays = dict[str, np.ndarray]
Compute = Callable[[int, dict[str, Arrays], Path], Arrays]


@dataclasses.dataclass(frozen=True)
class Data:
    """One kind of data.

    Attributes
    ----------
    name : str
        Of its folder, and the beginning of its files' names.
    compute : callable
        Makes a shard: from its number, the same shard of each of the sources by their names, and a
        folder in which filter banks are kept.
    sources : tuple of Data
        What it is made from. Shards that one of them lacks are left out.
    modules : tuple of str
        Modules beside this one that workers of a scheduler need, in the order of their imports.
    """

    name: str
    compute: Compute
    sources: tuple["Data", ...] = ()
    modules: tuple[str, ...] = ()

    def path(self, folder: Path, shard: int) -> Path:
        """File of a shard."""
        return folder / self.name / f"{self.name}_{shard:04d}.npz"

    def read(self, folder: Path, shard: int) -> Arrays:
        """Arrays of a shard."""
        with np.load(self.path(folder, shard)) as stored:
            return dict(stored)

    def exists(self, folder: Path, shard: int) -> bool:
        """Whether a shard was made already."""
        return self.path(folder, shard).exists()


def expand_pairs(pairs: Sequence[int]) -> list[int]:
    """Numbers from each first one to before each last one: `4 6 84 85` are 4, 5 and 84."""
    ends = zip(pairs[::2], pairs[1::2], strict=True)
    return [shard for first, last in ends for shard in range(first, last)]


def stack(items: Sequence[Arrays]) -> Arrays:
    """Arrays of several items, stacked along a new first axis."""
    return {name: np.stack([item[name] for item in items]) for name in items[0]}


def make(
    data: Data, folder: Path, shards: Sequence[int], processes: int = 1, scheduler: str = ""
) -> None:
    """Write the shards that are missing, those of the sources first; print a line for each.

    Parameters
    ----------
    data : Data
    folder : Path
        Holds one folder for each kind of data.
    shards : sequence of int
    processes : int
        How many share the work here.
    scheduler : str
        Address of a Dask scheduler whose workers make the shards instead. They need this package,
        and no common disk. Empty: none.
    """
    for source in data.sources:
        make(source, folder, shards, processes, scheduler)
    missing = [
        shard
        for shard in shards
        if not data.exists(folder, shard)
        and all(source.exists(folder, shard) for source in data.sources)
    ]
    if not missing:
        return
    start = time.perf_counter()
    banks = None if scheduler else folder / "banks"
    with _workers(data, processes, scheduler):
        # Shards of the sources are read when a worker is free: they take memory.
        made = Parallel(return_as="generator", batch_size=1, max_nbytes=None)(
            delayed(_compute)(data.compute, shard, _read_sources(data, folder, shard), banks)
            for shard in missing
        )
        for count, (shard, arrays) in enumerate(made, 1):
            path = data.path(folder, shard)
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(".part.npz")
            np.savez(part, **arrays)
            part.rename(path)
            spent_min = (time.perf_counter() - start) / 60
            left_min = spent_min / count * (len(missing) - count)
            print(
                f"{path.name}: {count} of {len(missing)}, {spent_min:.1f} min, "
                f"{left_min:.0f} min left",
                flush=True,
            )


def _read_sources(data: Data, folder: Path, shard: int) -> dict[str, Arrays]:
    return {source.name: source.read(folder, shard) for source in data.sources}


def _compute(
    compute: Compute, shard: int, sources: dict[str, Arrays], banks: Path | None
) -> tuple[int, Arrays]:
    """Shard and its number; workers of a scheduler keep their banks to themselves."""
    banks = banks or Path(tempfile.gettempdir()) / "coded_aperture_banks"
    return shard, compute(shard, sources, banks)


@contextmanager
def _workers(data: Data, processes: int, scheduler: str) -> Iterator[None]:
    """What joblib computes with: processes here, or the workers of a scheduler."""
    if not scheduler:
        with parallel_config("loky", n_jobs=processes):
            yield
        return
    # A scheduler in this process loads them anew from elsewhere.
    files = [str(Path(__file__).with_name(f"{name}.py")) for name in ("shards", *data.modules)]
    with dask_client(scheduler) as client:
        for file in files:
            client.upload_file(file)
        with parallel_config("dask", n_jobs=-1):
            yield
