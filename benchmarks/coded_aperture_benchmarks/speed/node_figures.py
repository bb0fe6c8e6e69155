"""What a stream of frames and a node's process are judged by."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.machine import processor_time_s

# What the node counts.
COUNTERS = ("received", "processed", "dropped", "rejected")


def latency_figures(stamps_ns: NDArray[np.int64], arrivals_ns: NDArray[np.int64]) -> dict[str, Any]:
    """Return the latencies of frames in ms, and whether they have grown; None of no frames.

    Parameters
    ----------
    stamps_ns, arrivals_ns : arrays of the same length
        When each frame was published and when its depth came, in the order of arrival.
    """
    latency_ms = (arrivals_ns - stamps_ns) * 1e-6
    quarter = -(-len(latency_ms) // 4)
    return {
        "median": rounded_or_none(np.median, latency_ms),
        "p99": rounded_or_none(lambda values: np.percentile(values, 99), latency_ms),
        "max": rounded_or_none(np.max, latency_ms),
        "median_first_quarter": rounded_or_none(np.median, latency_ms[:quarter]),
        "median_last_quarter": rounded_or_none(np.median, latency_ms[-quarter:]),
    }


def stream_figures(
    sent_ns: Sequence[int], received: dict[int, int], begun_ns: int, ended_ns: int
) -> dict[str, Any]:
    """Return what became of the frames that were sent in a span of time.

    Parameters
    ----------
    sent_ns : sequence of int
        Stamps of all frames that were sent.
    received : dict
        When the depth of a frame came, by its stamp.
    begun_ns, ended_ns : int
        Only frames with stamps from here to there count.
    """
    counted = [stamp for stamp in sent_ns if begun_ns <= stamp < ended_ns]
    come = np.array([stamp for stamp in counted if stamp in received], np.int64)
    arrivals = np.array([received[int(stamp)] for stamp in come], np.int64)
    seconds = (ended_ns - begun_ns) * 1e-9
    return {
        "sent": len(counted),
        "received": len(come),
        "received_hz": round(len(come) / seconds, 2),
        "never_came": len(counted) - len(come),
        "never_came_in_a_row": _longest_row(stamp not in received for stamp in counted),
        "longest_gap_ms": rounded_or_none(np.max, np.diff(arrivals) * 1e-6),
        "latency_ms": latency_figures(come, arrivals),
        "never_came_at_s": [
            round((stamp - begun_ns) * 1e-9, 3) for stamp in counted if stamp not in received
        ],
    }


def node_figures(
    statuses: Sequence[tuple[int, dict[str, str]]],
    sent_ns: Sequence[int],
    begun_ns: int,
    ended_ns: int,
) -> dict[str, Any]:
    """Return what the node counted, and the last values that it reported.

    Parameters
    ----------
    statuses : sequence of (time, values)
        All that the node has reported; the time in nanoseconds.
    sent_ns : sequence of int
        Stamps of all frames that were sent.
    begun_ns, ended_ns : int
        Only reports from here to there count.
    """
    counted = [status for status in statuses if begun_ns <= status[0] < ended_ns]
    if not counted:
        return {"seconds": 0.0, "sent": 0, **dict.fromkeys(COUNTERS, 0), "reported": {}}
    (first_ns, first), (last_ns, last) = counted[0], counted[-1]
    return {
        "seconds": round((last_ns - first_ns) * 1e-9, 2),
        "sent": sum(first_ns <= stamp < last_ns for stamp in sent_ns),
        **{name: int(last.get(name, 0)) - int(first.get(name, 0)) for name in COUNTERS},
        "reported": last,
    }


def process_figures(pid: int) -> dict[str, float]:
    """Return the memory of a process in MB and its processor time so far in seconds.

    Anonymous memory is what can leak; the rest are files and memory shared with other processes.
    """
    status = dict(
        line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines()
    )
    return {
        "rss_mb": int(status["VmRSS"].split()[0]) / 1024,
        "anonymous_mb": int(status["RssAnon"].split()[0]) / 1024,
        "processor_s": processor_time_s(pid),
    }


def run_figures(
    before: dict[str, float], after: dict[str, float], seconds: float
) -> dict[str, float]:
    """Return what a process has used between two of its `process_figures`."""
    return {
        "cores": round((after["processor_s"] - before["processor_s"]) / seconds, 2),
        **{
            f"{kind}_{when}_mb": round(figures[f"{kind}_mb"], 1)
            for kind in ("rss", "anonymous")
            for when, figures in (("begin", before), ("end", after))
        },
        "rss_growth_mb": round(after["rss_mb"] - before["rss_mb"], 1),
        "anonymous_growth_mb": round(after["anonymous_mb"] - before["anonymous_mb"], 1),
    }


def stolen_s() -> float:
    """Return the time so far that a virtual machine's processors waited for their host."""
    of_all = Path("/proc/stat").read_text().splitlines()[0].split()
    return int(of_all[8]) / os.sysconf("SC_CLK_TCK")


def rounded_or_none(function: Any, values: NDArray[np.floating]) -> float | None:
    """Return a statistic to two digits; None of no values."""
    return round(float(function(values)), 2) if len(values) else None


def _longest_row(missing: Iterator[bool]) -> int:
    longest = row = 0
    for is_missing in missing:
        row = row + 1 if is_missing else 0
        longest = max(longest, row)
    return longest
