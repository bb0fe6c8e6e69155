"""How times compare."""

from coded_aperture_ros.metrics.times import Times


def ratio(times: Times, other: Times) -> dict[str, float]:
    """Return how many times another's times these are."""
    return {"p50": times.p50_ms / other.p50_ms, "p99": times.p99_ms / other.p99_ms}
