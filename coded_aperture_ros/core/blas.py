"""BLAS, which computes NumPy's matrix products: its threads, and whether it is slow."""

import contextlib
import ctypes
import os
import re
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path

SLOW_BLAS_WARNING = (
    "NumPy uses the reference BLAS, which is 10 or more times slower than OpenBLAS: "
    "sudo apt install libopenblas0"
)
_MAPS = Path("/proc/self/maps")


def set_blas_variables() -> None:
    """Set one thread for OpenBLAS, unless the user has chosen.

    Its threads wait for each other actively: beside other work on the machine, learning a bank
    takes ten times longer with them. Call it before NumPy is imported, which reads the variable
    then.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


class _OneThread(contextlib.ContextDecorator):
    """Lets OpenBLAS use one thread, in all threads of this process, until the last one has left.

    Where the program has not called `set_blas_variables`, a frame took 1.7 times as much of the
    processors with OpenBLAS' threads beside those of `Workers`, as they wait actively.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._entered = 0
        self._before: list[int] = []

    def __enter__(self) -> None:
        with self._lock:
            self._entered += 1
            if self._entered == 1:
                self._before = [count() for count, _ in _thread_functions()]
                for _, limit in _thread_functions():
                    limit(1)

    def __exit__(self, *reason: object) -> None:
        with self._lock:
            self._entered -= 1
            if self._entered == 0:
                for (_, limit), before in zip(_thread_functions(), self._before, strict=True):
                    limit(before)


one_blas_thread = _OneThread()


@cache
def _thread_functions() -> list[tuple[Callable[[], int], Callable[[int], None]]]:
    """Functions that return and set the number of threads, of every OpenBLAS that is loaded."""
    found = []
    for path in sorted(set(re.findall(r"/.*openblas.*\.so.*", _mapped_files()))):
        with contextlib.suppress(OSError):
            library = ctypes.CDLL(path)
            for name in ("openblas_{}_num_threads", "scipy_openblas_{}_num_threads64_"):
                with contextlib.suppress(AttributeError):
                    get, put = (getattr(library, name.format(verb)) for verb in ("get", "set"))
                    found.append((get, put))
    return found


def slow_blas_warning(maps: Path = _MAPS) -> str | None:
    """Warning, in one line with its remedy; None if another BLAS is used, or it is unknown.

    Debian and Ubuntu choose among BLAS libraries by a link. The mapped files of this process show
    which one was loaded: `.../blas/libblas.so.3.12.0` is the reference; OpenBLAS, BLIS and ATLAS
    lie in folders of their own. Wheels contain OpenBLAS.

    Parameters
    ----------
    maps : Path
        Memory map of the process, in the format of Linux; None is returned where there is none.
    """
    import numpy as np

    np.linalg.norm([1.0])  # loads NumPy's linear algebra, and BLAS with it
    return SLOW_BLAS_WARNING if "/blas/libblas.so" in _mapped_files(maps) else None


def _mapped_files(maps: Path = _MAPS) -> str:
    """Memory map of this process; empty where there is none."""
    try:
        return maps.read_text(errors="replace")
    except OSError:
        return ""
