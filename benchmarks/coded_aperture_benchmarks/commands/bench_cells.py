"""Work through the cells of a benchmark's table, in several processes."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from coded_aperture_ros.cli.progress import progress
from coded_aperture_ros.core.errors import InputError

Cell = TypeVar("Cell")
Result = TypeVar("Result")


def measure_cells(
    measure: Callable[[Cell], Result], cells: Sequence[Cell], jobs: int
) -> list[Result]:
    """Measure every cell and return the results in order.

    Parameters
    ----------
    measure : callable
        A module's function, so that another process can import it.
    cells : sequence
        What it is called with, one at a time.
    jobs : int
        Number of processes; with 1 all happens in this one.

    Raises
    ------
    InputError
        As `measure` does, or if a process ended by itself.
    """
    jobs = min(jobs, len(cells))
    if jobs <= 1:
        return [measure(cell) for cell in progress(cells, len(cells), "cell")]
    # A forked process would inherit the locks of libraries' threads, but not the threads.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, initializer=_use_one_thread) as pool:
        with _no_interrupts():
            futures = [pool.submit(measure, cell) for cell in cells]
        try:
            for future in progress(as_completed(futures), len(futures), "cell"):
                future.result()  # the first error ends the run
        except BrokenProcessPool as error:
            raise InputError(
                "a process of the benchmark ended by itself, perhaps for lack of memory: "
                "use fewer --jobs"
            ) from error
        except BaseException:
            # Cells take minutes: do not wait for those that are under way.
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise
    return [future.result() for future in futures]


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """Start processes that ignore Ctrl-C, which a terminal sends to all: we answer it for them."""
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def _use_one_thread() -> None:
    """Leave the other processors to the other processes.

    BLAS reads its environment, which `coded_aperture` has set, when NumPy is imported.
    """
    import cv2

    cv2.setNumThreads(1)
