"""Who shared the cores while the demo ran."""

import time
from collections.abc import Callable, Mapping

from coded_aperture_ros.core.machine import BusyTime

SUBSCRIBER = "subscriber"
OTHERS = "other programs"


class SharedCores:
    """Cores that each node, this process and all other programs have taken since it was made.

    Parameters
    ----------
    nodes_s : callable
        Returns the processor time of each node so far, s.
    """

    def __init__(self, nodes_s: Callable[[], Mapping[str, float]]) -> None:
        self._nodes_s = nodes_s
        self._before_s = self._taken_s()
        self._busy = BusyTime.now()

    def shares(self) -> dict[str, float]:
        """Mean number of cores by who has taken them; nodes that ended meanwhile are left out."""
        seconds = time.monotonic() - self._busy.at_s
        taken_s = self._taken_s()
        shares = {name: (s - self._before_s[name]) / seconds for name, s in taken_s.items()}
        shares[OTHERS] = max(0.0, self._busy.cores() - sum(shares.values()))
        return {name: round(cores, 2) for name, cores in shares.items()}

    def _taken_s(self) -> dict[str, float]:
        return {**self._nodes_s(), SUBSCRIBER: time.process_time()}
