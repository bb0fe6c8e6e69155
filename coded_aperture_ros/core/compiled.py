"""Loops that numba compiles; where it is not installed, NumPy does the same in more passes."""

import contextlib
import logging
import threading
from collections.abc import Callable
from typing import Any

_COMPILING = threading.Lock()


class Compiled:
    """One function in two forms: a loop, and what stands for it without numba.

    The loop is compiled when it is first called, which takes a second or two, and kept on disk for
    the next time. Other threads go on while it runs. `loop` is made of plain loops over its arrays,
    some of which it writes to, and returns nothing; `plain` does the same by NumPy. Only with
    `finite` False may there be NaN and infinite values.
    """

    def __init__(
        self, loop: Callable[..., None], plain: Callable[..., None], *, finite: bool = True
    ) -> None:
        self.loop, self.plain, self._finite = loop, plain, finite
        self._chosen: Callable[..., None] | None = None

    def __call__(self, *arrays: Any) -> None:
        """Run the faster one of the two."""
        tried = self._chosen
        if tried is not None:
            with contextlib.suppress(Exception):  # arrays of another layout are compiled anew
                return tried(*arrays)
        with _COMPILING:
            if self._chosen is tried:
                self._chosen = self._choose(arrays)
                return None
        return self(*arrays)

    def _choose(self, arrays: tuple[Any, ...]) -> Callable[..., None]:
        """Return the form that works, having run it."""
        why: Exception | None = None
        for cache in (True, False):  # the folder may be missing, full, or hold a broken file
            try:
                from numba import njit

                compiled: Callable[..., None] = njit(
                    cache=cache, nogil=True, fastmath=self._finite
                )(self.loop)
                compiled(*arrays)  # compiles it first: what fails has not begun to write
                return compiled
            except Exception as error:
                why = error
        if not isinstance(why, ImportError):
            logging.getLogger(__name__).warning(
                f"numba cannot compile here, NumPy does the work more slowly: {why!r}"
            )
        self.plain(*arrays)
        return self.plain
