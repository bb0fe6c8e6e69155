"""A ROS domain that no other test process on this machine uses."""

import fcntl
import os
import tempfile
from pathlib import Path
from typing import IO

DOMAINS = range(1, 101)


def reserve_domain() -> tuple[int, IO[str]]:
    """Lock a free domain; it stays reserved while the returned file is open.

    Every worker of pytest-xdist is a process of its own, so each gets a domain of its own. The
    search begins at the process number, so that the domain of a run that has just ended, whose
    participants may still be seen, is not taken at once.
    """
    for offset in range(len(DOMAINS)):
        domain = DOMAINS[(os.getpid() + offset) % len(DOMAINS)]
        path = Path(tempfile.gettempdir()) / f"coded_aperture_ros-test-domain-{domain}"
        try:
            file = path.open("a")
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            continue
        return domain, file
    raise RuntimeError("all ROS domains from 1 to 100 are in use by tests")
