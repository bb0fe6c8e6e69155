"""What the machine can do, and the least time that some work takes on it."""

import dataclasses
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

_PRODUCT_SIDE = 1024
_PRODUCTS = 2
_COPY_BYTES = 128 * 2**20
_RATE_REPEATS = 5


@dataclasses.dataclass(frozen=True)
class Rates:
    """What the machine can do with some threads: the best of a few tries, and their median.

    Attributes
    ----------
    gemm_gflop_s, gemm_p50_gflop_s : float
        float32 matrix products, 1024 x 1024, every thread its own.
    copy_gb_s, copy_p50_gb_s : float
        Bytes read plus bytes written by copying arrays of 128 MiB in all.
    """

    threads: int
    gemm_gflop_s: float
    gemm_p50_gflop_s: float
    copy_gb_s: float
    copy_p50_gb_s: float


@dataclasses.dataclass(frozen=True)
class Roofline:
    """The least time that some work takes at the machine's rates.

    Attributes
    ----------
    gflop, mb : float
        The work: 10^9 operations, 10^6 bytes.
    limited_by : str
        `compute` or `memory`.
    attained : float
        The bound as a share of the time that was measured.
    """

    gflop: float
    mb: float
    bound_ms: float
    limited_by: str
    attained: float


def roofline(flop: float, moved_bytes: float, rates: Rates, measured_ms: float) -> Roofline:
    """Compare a time with the least that the machine's rates allow."""
    compute_ms = flop / rates.gemm_gflop_s / 1e6
    memory_ms = moved_bytes / rates.copy_gb_s / 1e6
    bound = max(compute_ms, memory_ms)
    return Roofline(
        gflop=flop / 1e9,
        mb=moved_bytes / 1e6,
        bound_ms=bound,
        limited_by="compute" if compute_ms >= memory_ms else "memory",
        attained=bound / measured_ms,
    )


def machine_rates(threads: int) -> Rates:
    """Measure what a number of threads can do.

    BLAS has to use one thread itself (``OPENBLAS_NUM_THREADS=1``).
    """
    random = np.random.default_rng(0)
    side = (_PRODUCT_SIDE, _PRODUCT_SIDE)
    factor = random.random(side, dtype=np.float32)
    products = [np.empty_like(factor) for _ in range(threads)]
    sources = [np.ones(_COPY_BYTES // 4 // threads, np.float32) for _ in range(threads)]
    targets = [np.zeros_like(source) for source in sources]

    def multiply(thread: int) -> None:
        for _ in range(_PRODUCTS):
            np.matmul(factor, factor, out=products[thread])

    def copy(thread: int) -> None:
        np.copyto(targets[thread], sources[thread])

    flop = 2.0 * _PRODUCT_SIDE**3 * _PRODUCTS * threads
    moved = 2.0 * sum(source.nbytes for source in sources)
    gemm_s = seconds_in_threads(multiply, threads, _RATE_REPEATS)
    copy_s = seconds_in_threads(copy, threads, _RATE_REPEATS)
    return Rates(
        threads=threads,
        gemm_gflop_s=flop / min(gemm_s) / 1e9,
        gemm_p50_gflop_s=flop / float(np.median(gemm_s)) / 1e9,
        copy_gb_s=moved / min(copy_s) / 1e9,
        copy_p50_gb_s=moved / float(np.median(copy_s)) / 1e9,
    )


@dataclasses.dataclass(frozen=True)
class BusyTime:
    """Processor time that all programs have taken until a moment, s."""

    at_s: float
    busy_s: float

    @classmethod
    def now(cls) -> "BusyTime":
        """Until now; user, nice, system, interrupts of the first line of /proc/stat."""
        of_all = Path("/proc/stat").read_text().splitlines()[0].split()
        ticks = sum(int(of_all[field]) for field in (1, 2, 3, 6, 7))
        return cls(time.monotonic(), ticks / os.sysconf("SC_CLK_TCK"))

    def cores(self) -> float:
        """Number of cores that were busy since then, all programs together."""
        now = BusyTime.now()
        return (now.busy_s - self.busy_s) / (now.at_s - self.at_s)


def seconds_in_threads(work: Callable[[int], None], threads: int, repeats: int) -> list[float]:
    """Return how long threads take together, each with ``work(thread)``; once unmeasured."""
    seconds = []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(repeats + 1):
            start = time.perf_counter()
            list(pool.map(work, range(threads)))
            seconds.append(time.perf_counter() - start)
    return seconds[1:]


@contextmanager
def opencv_threads(threads: int) -> Iterator[None]:
    """Let OpenCV use a number of threads for a while."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(threads)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
