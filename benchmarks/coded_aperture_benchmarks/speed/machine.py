"""What the machine can do, and the least time that some work takes on it."""

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np

from coded_aperture_ros.core.machine import product_rates, seconds_in_threads

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
    """Measure what a number of threads can do."""
    sources = [np.ones(_COPY_BYTES // 4 // threads, np.float32) for _ in range(threads)]
    targets = [np.zeros_like(source) for source in sources]

    def copy(thread: int) -> None:
        np.copyto(targets[thread], sources[thread])

    moved = 2.0 * sum(source.nbytes for source in sources)
    gflop_s = product_rates(threads)
    copy_s = seconds_in_threads(copy, threads, _RATE_REPEATS)
    return Rates(
        threads=threads,
        gemm_gflop_s=max(gflop_s),
        gemm_p50_gflop_s=float(np.median(gflop_s)),
        copy_gb_s=moved / min(copy_s) / 1e9,
        copy_p50_gb_s=moved / float(np.median(copy_s)) / 1e9,
    )


@contextmanager
def opencv_threads(threads: int) -> Iterator[None]:
    """Let OpenCV use a number of threads for a while."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(threads)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
