"""How much memory the process takes, as Linux tells it."""

import dataclasses
from pathlib import Path

_MIB = 2**20


@dataclasses.dataclass(frozen=True)
class Memory:
    """Resident memory of the process, 2^20 bytes; NaN where the system does not tell.

    Attributes
    ----------
    peak_mib : float
        The most while frames were measured.
    planned_mib : float
        What came with planning and the first frame.
    growth_mib : float
        From there to the end; of a leak it would be a multiple of the frames.
    """

    peak_mib: float
    planned_mib: float
    growth_mib: float


def memory_mib(name: str) -> float:
    """Return an entry of the process' memory; NaN elsewhere than on Linux."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return float("nan")
    found = [float(line.split()[1]) for line in lines if line.startswith(f"{name}:")]
    return found[0] * 1024 / _MIB if found else float("nan")


def forget_peak() -> None:
    """Let the peak of the memory begin here: learning a bank needs more than using it."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return
