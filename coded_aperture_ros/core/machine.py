"""Speed of this machine, and who takes its processors: what measured times stand beside."""

import dataclasses
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from coded_aperture_ros.core.blas import one_blas_thread

_PRODUCT_SIDE = 1024
_PRODUCTS = 2
_REPEATS = 5
_PROC = Path("/proc")


@one_blas_thread
def product_rates(threads: int) -> list[float]:
    """Rates of float32 matrix products, 1024 x 1024, every thread its own: tries, GFLOP/s."""
    factor = np.random.default_rng(0).random((_PRODUCT_SIDE, _PRODUCT_SIDE), dtype=np.float32)
    products = [np.empty_like(factor) for _ in range(threads)]

    def multiply(thread: int) -> None:
        for _ in range(_PRODUCTS):
            np.matmul(factor, factor, out=products[thread])

    flop = 2.0 * _PRODUCT_SIDE**3 * _PRODUCTS * threads
    return [flop / took_s / 1e9 for took_s in seconds_in_threads(multiply, threads, _REPEATS)]


def seconds_in_threads(work: Callable[[int], None], threads: int, repeats: int) -> list[float]:
    """Times that threads take together, each with ``work(thread)``; once unmeasured."""
    seconds = []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(repeats + 1):
            start = time.perf_counter()
            list(pool.map(work, range(threads)))
            seconds.append(time.perf_counter() - start)
    return seconds[1:]


@dataclasses.dataclass(frozen=True)
class BusyTime:
    """Processor time that all programs have taken until a moment, s."""

    at_s: float
    busy_s: float

    @classmethod
    def now(cls) -> "BusyTime":
        """Processor time until now: that of programs, the kernel and interrupts."""
        of_all = (_PROC / "stat").read_text().splitlines()[0].split()
        ticks = sum(int(of_all[field]) for field in (1, 2, 3, 6, 7))
        return cls(time.monotonic(), _seconds(ticks))

    def cores(self) -> float:
        """Number of cores that were busy since then, on the average; all programs together."""
        now = BusyTime.now()
        return (now.busy_s - self.busy_s) / (now.at_s - self.at_s)


def processor_time_s(pid: int) -> float:
    """Processor time that a process has taken so far, s."""
    # Fields 14 and 15; the second one is the name, in brackets, and may hold spaces.
    times = (_PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()[11:13]
    return _seconds(sum(map(int, times)))


def _seconds(ticks: int) -> float:
    return ticks / os.sysconf("SC_CLK_TCK")
