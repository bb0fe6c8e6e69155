"""Waiting for what other threads and processes do."""

import time


def wait_until(condition, timeout_s=10.0):
    """Wait until a condition holds; return its value, false after the timeout."""
    deadline = time.monotonic() + timeout_s
    while not (value := condition()) and time.monotonic() < deadline:
        time.sleep(0.01)
    return value
