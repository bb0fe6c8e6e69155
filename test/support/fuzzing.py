"""How many cases the tests try that draw them at random."""

import math
import os

from hypothesis import HealthCheck, settings

TIMES = float(os.environ.get("FUZZ_TIMES", "0.1"))


def cases(count):
    """Return the settings of a test of so many cases, or a part of them, or more."""
    return settings(
        max_examples=math.ceil(count * TIMES),
        deadline=None,
        # The tests try the same cases every time, `make fuzz` others each time.
        derandomize=TIMES < 1,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    )
