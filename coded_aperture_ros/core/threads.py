"""How many processors there are to work with."""

import os

from coded_aperture_ros.core.errors import InputError


def processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_threads(threads: int) -> None:
    """Refuse more threads than there are processors.

    Raises
    ------
    InputError
    """
    available = processors()
    if not 1 <= threads <= available:
        raise InputError(
            f"threads: {threads} is out of range: this machine has {available} processor(s) to "
            f"work with, use 1 to {available}"
        )
