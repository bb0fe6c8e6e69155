"""What the demo says and leaves behind."""

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from coded_aperture_ros.ros.demo_monitor import DemoMonitor, Snapshot

RESULTS = ("coded.png", "depth.png", "all_in_focus.png", "summary.json")


def summarise(monitor: "DemoMonitor", seconds: float) -> dict[str, Any]:
    """Return what was measured, ready for JSON; latencies are from the stamp to the reception."""
    from coded_aperture_ros.ros import demo_monitor

    summary: dict[str, Any] = {"seconds": seconds}
    for name, topic, node in (
        ("camera", demo_monitor.CODED, None),
        ("depth", demo_monitor.DEPTH, "depth_node"),
        ("deblur", demo_monitor.DEBLURRED, "deblur_node"),
    ):
        figures = monitor.figures(topic)
        entry: dict[str, Any] = {
            "frames": figures.frames,
            "rate_hz": round(figures.rate_hz, 3),
            "frames_in_each_second": figures.rates_hz,
        }
        median, p99, longest = figures.latency_s or (math.nan,) * 3
        entry.update(
            latency_median_s=_number(median), latency_p99_s=_number(p99),
            latency_max_s=_number(longest),
        )  # fmt: skip
        if node is not None:
            entry["dropped"] = monitor.count(node, "dropped")
            entry["rejected"] = monitor.count(node, "rejected")
        summary[name] = entry
    errors = monitor.depth_errors()
    summary["depth"]["median_relative_error"] = _median([e.median_relative for e in errors])
    summary["depth"]["coverage"] = _median([e.coverage for e in errors])
    return summary


def write_results(output: Path, snapshot: "Snapshot", summary: dict[str, Any]) -> None:
    """Write the pictures and the summary."""
    from coded_aperture_ros.core.files import atomic_output
    from coded_aperture_ros.imaging import SRGB
    from coded_aperture_ros.io import depth_picture, write_image

    write_image(output / "coded.png", snapshot.coded, bits=8, gamma=SRGB)
    write_image(output / "all_in_focus.png", snapshot.all_in_focus, bits=8, gamma=SRGB)
    write_image(output / "depth.png", depth_picture(snapshot.depth_m))
    with atomic_output(output / "summary.json") as path:
        path.write_text(json.dumps(summary, indent=2) + "\n")


def table(summary: dict[str, Any]) -> list[str]:
    """Return the figures as lines of text."""
    lines = [
        f"{'':8}{'rate Hz':>9}{'latency ms: median':>20}{'p99':>7}{'max':>7}{'dropped':>9}",
    ]
    for name in ("camera", "depth", "deblur"):
        entry = summary[name]
        latencies = [entry[f"latency_{part}_s"] for part in ("median", "p99", "max")]
        median, p99, longest = ("-" if s is None else f"{s * 1000:.0f}" for s in latencies)
        lines.append(
            f"{name:8}{entry['rate_hz']:9.1f}{median:>20}{p99:>7}{longest:>7}"
            f"{entry.get('dropped', ''):>9}"
        )
    error, coverage = summary["depth"]["median_relative_error"], summary["depth"]["coverage"]
    if error is None:
        lines.append("depth error: -")
    else:
        lines.append(f"depth error: median {error:.1%} (70 % most confident pixels), "
                     f"{coverage:.0%} of pixels have depth")  # fmt: skip
    return lines


class Speaker:
    """Prints progress: a table redrawn in place on a terminal, a line now and then elsewhere."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self.redraws = stream.isatty()
        self._drawn = 0

    def line(self, text: str) -> None:
        """Print a line that stays."""
        self._drawn = 0
        print(text, file=self._stream, flush=True)

    def table(self, lines: Sequence[str]) -> None:
        """Print lines that the next table takes the place of, on a terminal."""
        if self._drawn:
            print(f"\x1b[{self._drawn}A", end="", file=self._stream)
        for text in lines:
            print(f"{text}\x1b[K" if self.redraws else text, file=self._stream)
        self._stream.flush()
        self._drawn = len(lines) if self.redraws else 0


def figures_of_snapshot(snapshot: "Snapshot") -> dict[str, Any]:
    """Return what one frame and its results say, ready for JSON."""
    coded_db, all_in_focus_db = snapshot.psnr_db()
    return {
        "frame": [snapshot.coded.shape[1], snapshot.coded.shape[0]],
        "depth_image": [snapshot.depth_m.shape[1], snapshot.depth_m.shape[0]],
        "psnr_coded_db": _number(coded_db),
        "psnr_all_in_focus_db": _number(all_in_focus_db),
        "snapshot_depth": {
            name: _number(value)
            for name, value in dataclasses.asdict(snapshot.depth_error()).items()
        },
    }


def _number(value: float) -> float | None:
    """Return a number that JSON can hold."""
    return round(value, 4) if math.isfinite(value) else None


def _median(values: Sequence[float]) -> float | None:
    import numpy as np

    known = [value for value in values if math.isfinite(value)]
    return _number(float(np.median(known))) if known else None
