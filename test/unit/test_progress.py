"""Progress bars on a real terminal: when they appear, and that they leave nothing behind."""

import fcntl
import os
import pty
import struct
import sys
import termios
import threading
import time

import pytest

from coded_aperture_ros.core import progress as module
from coded_aperture_ros.core.progress import progress

DELAY_S = 0.1


@pytest.fixture
def terminal(monkeypatch):
    """Let stderr be a terminal of a width; return a function that ends it: all that it showed."""
    monkeypatch.setattr(module, "_BAR_DELAY_S", DELAY_S)
    shown, threads = [], []

    def opened(columns, rows=24):
        main, side = pty.openpty()
        fcntl.ioctl(side, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        stream = os.fdopen(side, "w")
        monkeypatch.setattr(sys, "stderr", stream)

        def read():
            try:
                while part := os.read(main, 4096):
                    shown.append(part.decode())
            except OSError:  # the other side has been closed
                os.close(main)

        threads.append(threading.Thread(target=read))
        threads[0].start()

        def closed():
            monkeypatch.undo()
            stream.close()
            threads[0].join()
            return "".join(shown)

        return closed

    return opened


@pytest.mark.parametrize("size", [(0, 0), (0, 24), (80, 0), (80, 24), (200, 50)])
def test_a_bar_appears_while_the_first_item_is_at_work(terminal, size):
    closed = terminal(*size)
    for _ in progress([1], unit="round"):
        time.sleep(5 * DELAY_S)
    text = closed()
    assert "0/1" in text
    assert "round/s" in text
    assert text.endswith("\r")  # cleared
    assert not text.rstrip("\r").rpartition("\r")[2].strip()


def test_a_bar_counts(terminal):
    closed = terminal(0)
    items = list(progress(iter(map(_slow, range(6))), 6, "frame"))
    assert items == list(range(6))
    assert "5/6" in closed()


def test_short_work_and_work_that_stops_show_nothing(terminal):
    closed = terminal(80)
    assert list(progress(range(3))) == [0, 1, 2]
    with pytest.raises(RuntimeError):
        for _ in progress(range(3)):
            raise RuntimeError
    steps = iter(progress(range(9)))
    assert next(steps) == 0
    del steps
    time.sleep(3 * DELAY_S)
    assert closed() == ""


def test_without_a_terminal_items_are_as_they_are():
    items = [1, 2]
    assert progress(items) is items


def _slow(number):
    time.sleep(2 * DELAY_S)
    return number
