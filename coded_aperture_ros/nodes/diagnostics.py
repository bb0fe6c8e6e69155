"""What a node tells about itself on /diagnostics: rate, latency, dropped and rejected frames."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile

_WINDOW_S = 10.0
# A latency beyond this is not one: the stamp comes from another clock than ours.
_PLAUSIBLE_LATENCY_S = 3600.0


@dataclass(frozen=True)
class Summary:
    """The state of a node's work at one moment; latencies and rate over the last 10 s."""

    received: int
    processed: int
    dropped: int
    rejected: dict[str, int]
    rate_hz: float
    latency_s: tuple[float, float, float] | None  # median, 99th percentile, maximum
    work_s: tuple[float, float, float] | None
    stages_s: dict[str, tuple[float, float, float]] = field(default_factory=dict)

    @property
    def rejected_total(self) -> int:
        """Return the number of messages of all kinds that could not be used."""
        return sum(self.rejected.values())


class Statistics:
    """Counts of one node's work; safe to use from several threads.

    Parameters
    ----------
    now : callable
        The clock that rates are measured by, in seconds.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._lock = threading.Lock()
        self._received = 0
        self._processed = 0
        self._dropped = 0
        self._rejected: Counter[str] = Counter()
        # When each frame was done, its latency, the time spent on it and that of its stages.
        self._recent: deque[tuple[float, float | None, float, Mapping[str, float]]] = deque(
            maxlen=2000
        )
        self._started_s: float | None = None

    def count_received(self) -> None:
        """Count a frame that arrived."""
        with self._lock:
            self._received += 1
            if self._started_s is None:
                self._started_s = self._now()

    def count_dropped(self) -> None:
        """Count a frame given up for a newer one."""
        with self._lock:
            self._dropped += 1

    def count_rejected(self, kind: str) -> None:
        """Count a message that cannot be used, by the kind of its fault."""
        with self._lock:
            self._rejected[kind] += 1

    def count_processed(
        self, latency_s: float | None, work_s: float, stages_s: Mapping[str, float] | None = None
    ) -> None:
        """Count a frame done.

        Parameters
        ----------
        latency_s : float or None
            From the frame's stamp to the publication of its last result; None if the stamp is
            not of this clock.
        work_s : float
            From taking up the frame to the publication of its last result.
        stages_s : mapping, optional
            Time of each stage of that work.
        """
        if latency_s is not None and not 0.0 <= latency_s <= _PLAUSIBLE_LATENCY_S:
            latency_s = None
        with self._lock:
            self._processed += 1
            self._recent.append((self._now(), latency_s, work_s, stages_s or {}))

    def summary(self) -> Summary:
        """Return the counts so far and the figures of the last seconds."""
        with self._lock:
            now = self._now()
            recent = [entry for entry in self._recent if entry[0] > now - _WINDOW_S]
            running_s = 0.0 if self._started_s is None else now - self._started_s
            span_s = min(_WINDOW_S, max(running_s, 1.0))
            return Summary(
                self._received,
                self._processed,
                self._dropped,
                dict(self._rejected),
                len(recent) / span_s,
                percentiles([latency for _, latency, _, _ in recent if latency is not None]),
                percentiles([work for _, _, work, _ in recent]),
                _by_stage([stages for _, _, _, stages in recent]),
            )


def _by_stage(frames: list[Mapping[str, float]]) -> dict[str, tuple[float, float, float]]:
    by_stage: dict[str, list[float]] = {}
    for stages in frames:
        for stage, seconds in stages.items():
            by_stage.setdefault(stage, []).append(seconds)
    figures = {stage: percentiles(values) for stage, values in by_stage.items()}
    return {stage: three for stage, three in figures.items() if three is not None}


def percentiles(values: list[float]) -> tuple[float, float, float] | None:
    """Return the median, the 99th percentile and the maximum; None of nothing."""
    if not values:
        return None
    median, high = np.percentile(values, (50, 99))
    return float(median), float(high), float(max(values))


def status_of(
    name: str, summary: Summary, newly_rejected: int, stalled: bool, fruitless: bool = False
) -> DiagnosticStatus:
    """Return the diagnostic status of a node's work.

    Parameters
    ----------
    name : str
        Of the node, with its namespace.
    summary : Summary
    newly_rejected : int
        Messages that could not be used since the last status.
    stalled : bool
        Frames are waited for and none has come since the last status.
    fruitless : bool
        Frames have come since the last status and before, and nothing has been made of them.
    """
    status = DiagnosticStatus(name=f"{name.lstrip('/')}: frames", level=DiagnosticStatus.OK)
    status.message = f"{summary.rate_hz:.1f} frames/s"
    if stalled:
        status.level, status.message = DiagnosticStatus.WARN, "waiting for frames"
    if fruitless:
        status.level, status.message = DiagnosticStatus.WARN, "frames come in, no results go out"
    if newly_rejected:
        status.level = DiagnosticStatus.WARN
        status.message = f"{newly_rejected} unusable message(s) in the last second"
    values = {
        "rate_hz": f"{summary.rate_hz:.2f}",
        "received": str(summary.received),
        "processed": str(summary.processed),
        "dropped": str(summary.dropped),
        "rejected": str(summary.rejected_total),
    }
    for kind, count in sorted(summary.rejected.items()):
        values[f"rejected_{kind}"] = str(count)
    stages = [(f"stage_{stage}", figures) for stage, figures in summary.stages_s.items()]
    for label, figures in (("latency", summary.latency_s), ("work", summary.work_s), *stages):
        if figures is not None:
            for part, value in zip(("median", "p99", "max"), figures, strict=True):
                values[f"{label}_{part}_ms"] = f"{value * 1000:.1f}"
    status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
    return status


class DiagnosticsPublisher:
    """Publishes a node's statistics on /diagnostics once a second.

    By a steady clock: under `use_sim_time` a timer of the node's own clock would stand still
    until a /clock comes.
    """

    def __init__(self, node: Node, statistics: Statistics, expecting: Callable[[], bool]) -> None:
        self._node = node
        self._statistics = statistics
        self._expecting = expecting
        self._last = statistics.summary()
        self._publisher = node.create_publisher(
            DiagnosticArray, "/diagnostics", QoSProfile(depth=5)
        )
        node.create_timer(1.0, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Publish the present state."""
        summary = self._statistics.summary()
        status = status_of(
            self._node.get_fully_qualified_name(),
            summary,
            summary.rejected_total - self._last.rejected_total,
            self._expecting() and summary.received == self._last.received,
            summary.rate_hz == 0 and summary.received > self._last.received > 0,
        )
        self._last = summary
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
