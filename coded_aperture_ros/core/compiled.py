"""Loops that numba compiles; without numba, NumPy computes the same in more passes."""

import contextlib
import logging
import threading
from collections.abc import Callable
from numbers import Number
from pathlib import Path
from types import FunctionType
from typing import Any

_COMPILING = threading.Lock()


class Compiled:
    """Function in two forms: a loop for numba, and its replacement without numba.

    The loop is compiled at the first call, which takes a second or two, and cached on disk. It
    runs without Python's global lock.

    Parameters
    ----------
    loop : callable
        Plain loops over its arrays, some of which it writes to; returns nothing.
    plain : callable
        The same with NumPy.
    finite : bool
        Whether all values are finite; with False there may be NaN and infinite ones. A division by
        zero is no error.

    Examples
    --------
    >>> import numpy as np
    >>> def double_loop(values, doubled):
    ...     for index in range(values.size):
    ...         doubled[index] = 2 * values[index]
    >>> def double_plain(values, doubled):
    ...     np.multiply(values, 2, out=doubled)
    >>> double = Compiled(double_loop, double_plain)
    >>> doubled = np.zeros(3)
    >>> double(np.arange(3.0), doubled)
    >>> doubled
    array([0., 2., 4.])
    """

    def __init__(
        self, loop: Callable[..., None], plain: Callable[..., None], *, finite: bool = True
    ) -> None:
        self.loop = loop
        self.plain = plain
        self._finite = finite
        self._chosen: Callable[..., None] | None = None

    def __call__(self, *arrays: Any) -> None:
        """Run the compiled loop, or else the replacement."""
        tried = self._chosen
        if tried is not None:
            with contextlib.suppress(Exception):  # arrays of another layout: compile again
                return tried(*arrays)
        with _COMPILING:
            if self._chosen is tried:
                self._chosen = self._choose(arrays)
                return None
        return self(*arrays)

    def _choose(self, arrays: tuple[Any, ...]) -> Callable[..., None]:
        """Form that works here; it has been run with the arrays."""
        why: Exception | None = None
        for cache in (True, False):  # the folder may be missing, full, or hold a broken file
            try:
                from numba import njit

                # Errors of division would keep loops from vector instructions.
                options = {"cache": cache, "nogil": True, "error_model": "numpy"}
                compiled = self._made(njit(**options, fastmath=self._finite))
                _mark_constants(compiled, self.loop)
                compiled(*arrays)  # compiles it first: a failure leaves the arrays as they are
                return compiled
            except Exception as error:
                why = error
        if not isinstance(why, ImportError):
            logging.getLogger(__name__).warning(
                f"numba cannot compile here, using NumPy, which is slower: {why!r}"
            )
        self.plain(*arrays)
        return self.plain

    def _made(self, compiles: Callable[..., Any]) -> Callable[..., None]:
        """Loop that is compiled when it is called."""
        return compiles(self.loop)


def _mark_constants(compiled: Any, loop: Callable[..., None]) -> None:
    """Have the stored code of a loop compiled anew where something that it names has changed.

    numba looks at the loop's own file only; numbers and functions may be imported from another.
    """
    # numba keeps this to itself: a version that has it elsewhere looks at the file only.
    with contextlib.suppress(AttributeError, OSError):
        stored, values = compiled._cache._cache_file, loop.__globals__
        stamps = [(name, _stamp(values.get(name))) for name in sorted(loop.__code__.co_names)]
        stored._source_stamp = (stored._source_stamp, stamps)


def _stamp(value: Any) -> Any:
    """What changes with a number, or with the file of a function; None for anything else."""
    if isinstance(value, FunctionType):
        return Path(value.__code__.co_filename).stat().st_mtime_ns
    return repr(value) if isinstance(value, Number) else None
