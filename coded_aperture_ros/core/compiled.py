"""Loops that numba compiles; where it is not installed, NumPy does the same in more passes."""

from collections.abc import Callable
from typing import Any


class Compiled:
    """One function in two forms: a loop, and what stands for it without numba.

    The loop is compiled when it is first called, which takes a second or two, and kept on disk for
    the next time. Other threads go on while it runs.

    Parameters
    ----------
    loop : callable
        Of plain loops over its arrays, some of which it writes to; returns nothing.
    plain : callable
        Does the same by NumPy.
    """

    def __init__(self, loop: Callable[..., None], plain: Callable[..., None]) -> None:
        self.loop, self.plain = loop, plain
        self._chosen: Callable[..., None] | None = None

    def __call__(self, *arrays: Any) -> None:
        """Run the faster one of the two."""
        if self._chosen is None:
            self._chosen = self._choose()
        self._chosen(*arrays)

    def _choose(self) -> Callable[..., None]:
        try:
            from numba import njit
        except ImportError:
            return self.plain
        options: dict[str, Any] = {"nogil": True, "fastmath": True}
        compiled: Callable[..., None]
        try:
            compiled = njit(cache=True, **options)(self.loop)
        except RuntimeError:  # there is no folder to keep it in
            compiled = njit(**options)(self.loop)
        return compiled
