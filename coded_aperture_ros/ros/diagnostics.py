"""Status of a node on /diagnostics: rate, latency, dropped and rejected frames."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile

from coded_aperture_ros.core.options import option

# Rates and latencies are of so long.
_WINDOW_S = 10.0
# A larger latency is not plausible: the stamp comes from another clock than the node's.
_PLAUSIBLE_LATENCY_S = 3600.0


@dataclass(frozen=True)
class DiagnosticsConfig:
    """Limits beyond which /diagnostics warns."""

    parameter_group = "diagnostics."
    warn_latency_ms: float = option(
        0.0,
        "Warn if the 99th percentile of the latency exceeds this; 0: never",
        unit="ms",
        within=(0.0, 1e6),
    )
    warn_rate_hz: float = option(
        0.0,
        "Warn if fewer frames than this are processed per second; 0: never",
        unit="Hz",
        within=(0.0, 10_000.0),
    )
    warn_dropped_share: float = option(
        1.0,
        "Warn if more than this share of the last second's frames was dropped; 1: never",
        within=(0.0, 1.0),
    )


@dataclass(frozen=True)
class Complaint:
    """Fault of the last frame, which could be processed all the same.

    Attributes
    ----------
    text : str
        What is wrong.
    serious : bool
        Whether no result of the frame can be relied on.
    """

    text: str
    serious: bool = False


@dataclass(frozen=True)
class Summary:
    """State of a node's work at one moment; rate and durations are of the last 10 s.

    Attributes
    ----------
    received, processed : int
        Frames.
    dropped_by, rejected : dict of str to int
        Dropped frames by cause, and unusable messages by kind of fault.
    rate_hz : float
        Processed frames per second.
    latency_s, work_s : (float, float, float) or None
        Median, 99th percentile and maximum of the time from stamp to result, and of the work.
    stages_s : dict of str to (float, float, float) or None
        The same of each stage.
    figures : dict of str to float
        Of the last frame; empty after 10 s without one.
    last_error : str
        Empty once there have been 10 s of results without an error.
    complaint : Complaint or None
        About the last frame; None after 10 s without one.
    idle_s : float or None
        Time since the last frame arrived; None before the first.
    without_depth : int
        Frames whose depth has not come; they are neither processed nor dropped.
    """

    received: int
    processed: int
    dropped_by: dict[str, int]
    rejected: dict[str, int]
    rate_hz: float
    latency_s: tuple[float, float, float] | None
    work_s: tuple[float, float, float] | None
    stages_s: dict[str, tuple[float, float, float] | None] = field(default_factory=dict)
    figures: dict[str, float] = field(default_factory=dict)
    last_error: str = ""
    complaint: Complaint | None = None
    idle_s: float | None = None
    without_depth: int = 0

    @property
    def dropped(self) -> int:
        """Number of dropped frames, whatever the cause."""
        return sum(self.dropped_by.values())

    @property
    def rejected_total(self) -> int:
        """Number of unusable messages, whatever the fault."""
        return sum(self.rejected.values())


class Statistics:
    """Counters of one node's work; safe to use from several threads.

    Parameters
    ----------
    now : callable
        Clock, seconds.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._lock = threading.Lock()
        self._received = 0
        self._processed = 0
        self._dropped: Counter[str] = Counter()
        self._without_depth = 0
        self._rejected: Counter[str] = Counter()
        # Of each frame: time when it was done, latency, time of the work, time of its stages.
        self._recent: deque[tuple[float, float | None, float, Mapping[str, float]]] = deque()
        self._started_s: float | None = None
        self._received_s: float | None = None
        self._rejected_s = 0.0
        self._figures: Mapping[str, float] = {}
        self._complaint: Complaint | None = None
        self._last_error = ""

    def count_received(self) -> None:
        """Count a frame that arrived."""
        with self._lock:
            self._received += 1
            self._received_s = self._now()
            if self._started_s is None:
                self._started_s = self._received_s

    def count_dropped(self, cause: str) -> None:
        """Count a good frame that was not processed, by cause (busy, max_rate)."""
        with self._lock:
            self._dropped[cause] += 1

    def count_without_depth(self) -> None:
        """Count a good frame whose depth has not come: depth may be slower than the camera."""
        with self._lock:
            self._without_depth += 1

    def count_rejected(self, kind: str, reason: str = "") -> None:
        """Count an unusable message, by the kind of its fault, and keep the reason."""
        with self._lock:
            self._rejected[kind] += 1
            self._last_error = reason or kind
            self._rejected_s = self._now()

    def count_processed(
        self,
        latency_s: float | None,
        work_s: float,
        stages_s: Mapping[str, float] | None = None,
        figures: Mapping[str, float] | None = None,
        complaint: Complaint | None = None,
    ) -> None:
        """Count a frame whose last result has been published.

        Parameters
        ----------
        latency_s : float or None
            Time since its stamp; None if the stamp is of another clock.
        work_s : float
            Time since the work on it began.
        stages_s : mapping of str to float, optional
            Time of each stage.
        figures : mapping of str to float, optional
            Further values for /diagnostics, by names that end in their unit.
        complaint : Complaint, optional
        """
        if latency_s is not None and not 0.0 <= latency_s <= _PLAUSIBLE_LATENCY_S:
            latency_s = None
        with self._lock:
            self._processed += 1
            self._figures = figures or {}
            self._complaint = complaint
            self._recent.append((self._now(), latency_s, work_s, stages_s or {}))
            while self._recent[0][0] <= self._recent[-1][0] - _WINDOW_S:
                self._recent.popleft()

    def summary(self) -> Summary:
        """Counts since the start, and rate and durations of the last 10 s."""
        with self._lock:
            now = self._now()
            recent = [entry for entry in self._recent if entry[0] > now - _WINDOW_S]
            running_s = 0.0 if self._started_s is None else now - self._started_s
            span_s = min(_WINDOW_S, max(running_s, 1.0))
            recovered = recent and now - self._rejected_s > _WINDOW_S
            latencies_s = [latency for _, latency, _, _ in recent if latency is not None]
            return Summary(
                received=self._received,
                processed=self._processed,
                dropped_by=dict(self._dropped),
                without_depth=self._without_depth,
                rejected=dict(self._rejected),
                rate_hz=len(recent) / span_s,
                latency_s=percentiles(latencies_s),
                work_s=percentiles([work for _, _, work, _ in recent]),
                stages_s=_by_stage([stages for _, _, _, stages in recent]),
                figures=dict(self._figures) if recent else {},
                last_error="" if recovered else self._last_error,
                complaint=self._complaint if recent else None,
                idle_s=None if self._received_s is None else now - self._received_s,
            )


def camera_name(node: Node) -> str:
    """Name of the camera that a node belongs to: the end of its namespace, or `camera`."""
    return node.get_namespace().rpartition("/")[2] or "camera"


def _by_stage(frames: list[Mapping[str, float]]) -> dict[str, tuple[float, float, float] | None]:
    stages = dict.fromkeys(stage for seconds in frames for stage in seconds)
    return {name: percentiles([each[name] for each in frames if name in each]) for name in stages}


def percentiles(values: list[float]) -> tuple[float, float, float] | None:
    """Median, 99th percentile and maximum; None if there are no values."""
    if not values:
        return None
    median, high = np.percentile(values, (50, 99))
    return float(median), float(high), float(max(values))


def status_of(
    name: str,
    summary: Summary,
    last: Summary,
    config: DiagnosticsConfig,
    *,
    hardware_id: str = "",
    waiting: bool = False,
    active: bool = True,
    identity: Mapping[str, str] = MappingProxyType({}),
) -> DiagnosticStatus:
    """Diagnostic status of a node.

    Parameters
    ----------
    name : str
        Of the node, with its namespace.
    summary, last : Summary
        Now, and when the status was published before.
    config : DiagnosticsConfig
    hardware_id : str
        Camera that the frames come from.
    waiting : bool
        Whether the node is subscribed to frames.
    active : bool
        Whether the node has been activated.
    identity : mapping of str to str
        Files that it uses.
    """
    status = DiagnosticStatus(name=f"{name.lstrip('/')}: frames", hardware_id=hardware_id)
    status.message = f"{summary.rate_hz:.1f} frames/s" if active else "not active"
    warnings = list(_warnings(summary, last, config, waiting)) if active else []
    if warnings:
        serious = summary.complaint is not None and summary.complaint.serious
        status.level = DiagnosticStatus.ERROR if serious else DiagnosticStatus.WARN
        status.message = "; ".join(warnings)
    values = {
        "rate_hz": f"{summary.rate_hz:.2f}",
        "received": str(summary.received),
        "processed": str(summary.processed),
        "dropped": str(summary.dropped),
        "rejected": str(summary.rejected_total),
    }
    if summary.without_depth:
        values["without_depth"] = str(summary.without_depth)
    for cause, count in sorted(summary.dropped_by.items()):
        values[f"dropped_{cause}"] = str(count)
    for kind, count in sorted(summary.rejected.items()):
        values[f"rejected_{kind}"] = str(count)
    stages = [(f"stage_{stage}", figures) for stage, figures in summary.stages_s.items()]
    for label, figures in (("latency", summary.latency_s), ("work", summary.work_s), *stages):
        if figures is not None:
            for part, value in zip(("median", "p99", "max"), figures, strict=True):
                values[f"{label}_{part}_ms"] = f"{value * 1000:.1f}"
    values.update({name: f"{value:.3f}" for name, value in summary.figures.items()})
    values.update(identity)
    values["last_error"] = summary.last_error or "none"
    status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
    return status


def _warnings(
    summary: Summary, last: Summary, config: DiagnosticsConfig, waiting: bool
) -> Iterator[str]:
    received = summary.received - last.received
    rejected = summary.rejected_total - last.rejected_total
    dropped = summary.dropped - last.dropped
    if summary.complaint is not None:
        yield summary.complaint.text
    if rejected:
        yield f"{rejected} unusable message(s) in the last second, see last_error"
    if waiting and not received:
        age = "" if summary.idle_s is None else f": none for {summary.idle_s:.0f} s"
        yield f"waiting for frames{age}"
    elif received and last.received and summary.rate_hz == 0:
        missing = summary.without_depth > last.without_depth
        yield f"frames arrive, but no {'depth does' if missing else 'results are published'}"
    elif received and summary.rate_hz < config.warn_rate_hz:
        yield f"{summary.rate_hz:.1f} frames/s, less than {config.warn_rate_hz:g}"
    if received and dropped > config.warn_dropped_share * received:
        yield f"{dropped} of {received} frames dropped"
    late_ms = summary.latency_s[1] * 1000 if summary.latency_s else 0.0
    if config.warn_latency_ms and late_ms > config.warn_latency_ms:
        yield f"latency {late_ms:.0f} ms, more than {config.warn_latency_ms:g} ms"


class DiagnosticsPublisher:
    """Publishes a node's status on /diagnostics once a second.

    By a steady clock: under `use_sim_time` the node's own would stand still until a /clock comes.

    Parameters
    ----------
    node : Node
    statistics : Statistics
    describe : callable
        Returns the keyword arguments of `status_of`.
    """

    def __init__(
        self, node: Node, statistics: Statistics, describe: Callable[[], Mapping[str, Any]]
    ) -> None:
        self._node = node
        self._statistics = statistics
        self._describe = describe
        self._last = statistics.summary()
        qos = QoSProfile(depth=5)
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(1.0, self._publish, clock=steady)

    def _publish(self) -> None:
        last, self._last = self._last, self._statistics.summary()
        name = self._node.get_fully_qualified_name()
        message = DiagnosticArray(status=[status_of(name, self._last, last, **self._describe())])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def close(self) -> None:
        """Stop publishing."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)
