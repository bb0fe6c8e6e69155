"""Waiting for threads, processes and programs, with limits that scale with the machine.

A limit is written in seconds of an idle machine like the one that CI has. A slower machine, and
one that has more to do than it has processors, gets as much more time.
"""

import glob
import os
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

# What `_loop` takes on an idle machine of 2 GHz.
_REFERENCE_S = 0.015
_LOADS = Path("/proc/loadavg")


def _loop():
    total = 0
    for number in range(200_000):
        total += number
    return total


@cache
def slowness():
    """How much slower than the reference this machine computes; at least 1, measured once."""
    times = []
    for _ in range(5):
        began = time.perf_counter()
        _loop()
        times.append(time.perf_counter() - began)
    # The quickest: what else the machine does is counted by `load`.
    return max(1.0, min(times) / _REFERENCE_S)


def load():
    """Tasks that want a processor, now or over the last minute, per processor; at least 1."""
    averaged = os.getloadavg()[0]
    running = float(_LOADS.read_text().split()[3].split("/")[0]) if _LOADS.exists() else 0.0
    return max(1.0, max(averaged, running) / len(os.sched_getaffinity(0)))


def scaled(seconds):
    """The time that this machine may now take for what an idle one does in `seconds`."""
    return seconds * slowness() * load()


def wait_until(condition, timeout_s=30.0, every_s=0.01):
    """Wait until a condition holds; return its value, false after the scaled timeout."""
    began = time.monotonic()
    while not (value := condition()):
        elapsed_s = time.monotonic() - began
        if elapsed_s > timeout_s and elapsed_s > scaled(timeout_s):
            break
        time.sleep(every_s)
    return value


def matching(folder, pattern):
    """Return what a pattern finds in a folder in which another program adds and removes folders.

    `Path.glob` of Python before 3.13 raises where a folder goes away while it is read.
    """
    return glob.glob(str(folder / pattern))


def stays_false(condition, seconds):
    """Return whether a condition does not come true within so many seconds, not scaled."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return False
        time.sleep(0.01)
    return True


def is_silent(received, seconds):
    """Return whether nothing new comes for so many seconds, not scaled."""
    count = len(received)
    return stays_false(lambda: len(received) > count, seconds)


def run_program(*command, timeout_s=60.0, check=False, **options):
    """Run a program to its end; return its status and, as text, what it wrote."""
    return subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        check=check,
        timeout=scaled(timeout_s),
        **options,
    )


def run_python(*arguments, **options):
    """Run Python, as `run_program` does."""
    return run_program(sys.executable, *arguments, **options)


def output_of(process, timeout_s=30.0):
    """Wait for the end of a process; return what it wrote to both of its pipes."""
    return process.communicate(timeout=scaled(timeout_s))
