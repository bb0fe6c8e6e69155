"""Work of a process that is killed while it sends its result, as for lack of memory."""

import os
import signal
from multiprocessing.connection import Connection


def _send_half(connection, data, *_):
    os.write(connection.fileno(), data[: len(data) // 2])
    os.kill(os.getpid(), signal.SIGKILL)


def killed_in_between(number):
    """Return a result too large for one go; the process that has number 3 is killed then."""
    if number == 3:
        Connection._send = _send_half
    return bytes(100_000)
