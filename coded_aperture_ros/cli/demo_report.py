"""What the demo says and leaves behind."""

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bags.score import resize_reference
from coded_aperture_ros.cli.demo_page import Picture, demo_page
from coded_aperture_ros.core.files import atomic_output
from coded_aperture_ros.core.text import rounded
from coded_aperture_ros.frames import SRGB, pixels_from_linear
from coded_aperture_ros.io import depth_picture, error_picture, write_image
from coded_aperture_ros.io.panels import panels
from coded_aperture_ros.metrics.errors import psnr_db

if TYPE_CHECKING:
    from coded_aperture_ros.ros.demo_monitor import DemoMonitor

_LATENCIES = ("latency_median_s", "latency_p99_s", "latency_max_s")
PICTURES = ("coded.png", "depth.png", "all_in_focus.png", "comparison.png")
RESULTS = (*PICTURES, "summary.json", "index.html")
# Where the scale of relative depth errors ends: three times what counts as right.
_LARGEST_ERROR = 0.3


def summarise(monitor: "DemoMonitor", seconds: float) -> dict[str, Any]:
    """Return what was measured, ready for JSON; latencies are from the stamp to the reception."""
    from coded_aperture_ros.ros import demo_monitor

    summary: dict[str, Any] = {"seconds": seconds}
    for name, topic, node in (
        ("camera", demo_monitor.CODED, None),
        ("depth", demo_monitor.DEPTH, "depth_node"),
        ("deblur", demo_monitor.DEBLURRED, "deblur_node"),
    ):
        summary[name] = stream_figures(monitor.arrivals(topic), seconds)
        if node is not None:
            summary[name] |= {key: monitor.count(node, key) for key in ("dropped", "rejected")}
    errors = monitor.depth_errors()
    summary["depth"]["median_relative_error"] = _median([e.median_relative for e in errors])
    summary["depth"]["coverage"] = _median([e.coverage for e in errors])
    return summary


def stream_figures(arrivals: Sequence[tuple[float, float]], seconds: float) -> dict[str, Any]:
    """Return rate and latency of messages by their arrival and latency, s, ready for JSON."""
    from coded_aperture_ros.ros.diagnostics import percentiles

    of_second = np.bincount([int(at_s) for at_s, _ in arrivals], minlength=int(seconds))
    latencies_s = percentiles([latency_s for _, latency_s in arrivals]) or (math.nan,) * 3
    return {
        "frames": len(arrivals),
        "rate_hz": round(len(arrivals) / seconds, 3),
        "frames_in_each_second": of_second[: int(seconds)].tolist(),
        **dict(zip(_LATENCIES, (rounded(s, 4) for s in latencies_s), strict=True)),
    }


def cores_line(summary: dict[str, Any]) -> str:
    """Return who took the processors, the machine's speed, and what depth did alone."""
    machine, alone = summary["machine"], summary["depth_alone"]
    shares = ", ".join(f"{name} {cores:.2f}" for name, cores in summary["cores"].items())
    alone_ms = alone["latency_median_s"]
    latency = "-" if alone_ms is None else f"{1000 * alone_ms:.0f} ms"
    return (
        f"cores taken: {shares}; of this machine {machine['threads']} threads have "
        f"{machine['gflop_s']:.0f} GFLOP/s in float32 matrix products\n"
        f"depth without deblurring: {alone['rate_hz']:.1f} Hz, {latency}"
    )


def write_results(output: Path, snapshot: dict[str, NDArray], summary: dict[str, Any]) -> None:
    """Write the pictures, the summary, and a page that has both and needs no other file."""
    from coded_aperture_ros.ros.demo_monitor import CODED, DEBLURRED, DEPTH

    write_image(output / "coded.png", snapshot[CODED], bits=8, gamma=SRGB)
    write_image(output / "all_in_focus.png", snapshot[DEBLURRED], bits=8, gamma=SRGB)
    write_image(output / "depth.png", depth_picture(snapshot[DEPTH]))
    shown = _pictures(snapshot)
    titled = [(picture.title, picture.pixels) for picture in shown]
    write_image(output / "comparison.png", panels([titled[:3], titled[3:]]))
    with atomic_output(output / "summary.json") as path:
        path.write_text(json.dumps(summary, indent=2) + "\n")
    with atomic_output(output / "index.html") as path:
        path.write_text(demo_page(shown, summary), "utf-8")


def _pictures(snapshot: dict[str, NDArray]) -> list[Picture]:
    """What was found, and below it what is there."""
    from coded_aperture_ros.ros import demo_monitor as topics

    found = resize_reference(snapshot[topics.DEPTH], snapshot[topics.TRUE_DEPTH].shape)
    truth = snapshot[topics.TRUE_DEPTH]
    known = truth[np.isfinite(truth)]
    range_m = (float(known.min()), float(known.max())) if known.size else (1.0, 2.0)
    error = np.abs(found - truth) / truth
    errors = 0.0, 100 * _LARGEST_ERROR

    def light(topic: str) -> NDArray[np.uint8]:
        picture = np.asarray(pixels_from_linear(snapshot[topic], 8, SRGB), np.uint8)
        return picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)

    return [
        Picture("Coded frame", "What the camera with the mask sees.", light(topics.CODED)),
        Picture(
            "Depth",
            "Found in this one frame. Hatched: unknown.",
            depth_picture(found, *range_m),
            range_m,
        ),
        Picture("All in focus", "Made of the frame and its depth.", light(topics.DEBLURRED)),
        Picture(
            "Relative error of depth",
            f"Against the true depth; {errors[1]:.0f} % or more is dark red. Hatched: unknown.",
            error_picture(error, _LARGEST_ERROR),
            errors,
            unit="%",
            near_is_red=False,
        ),
        Picture("True depth", "Of the scene's model.", depth_picture(truth, *range_m), range_m),
        Picture("Sharp scene", "Without lens, mask and noise.", light(topics.TRUE_IMAGE)),
    ]


def table(summary: dict[str, Any]) -> list[str]:
    """Return the figures as lines of text."""
    lines = [f"{'':8}{'rate Hz':>9}{'latency ms: median':>20}{'p99':>7}{'max':>7}{'dropped':>9}"]
    for name in ("camera", "depth", "deblur"):
        entry = summary[name]
        latencies = (entry[key] for key in _LATENCIES)
        median, p99, longest = ("-" if s is None else f"{s * 1000:.0f}" for s in latencies)
        lines.append(
            f"{name:8}{entry['rate_hz']:9.1f}{median:>20}{p99:>7}{longest:>7}"
            f"{entry.get('dropped', ''):>9}"
        )
    error, coverage = (summary["depth"][key] for key in ("median_relative_error", "coverage"))
    if error is None:
        return [*lines, "depth error: -"]
    of_what = "70 % most confident pixels"
    return [
        *lines,
        f"depth error: median {error:.1%} ({of_what}), {coverage:.0%} of pixels have depth",
    ]


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


def figures_of_snapshot(snapshot: dict[str, NDArray]) -> dict[str, Any]:
    """Return what one frame and its results say, ready for JSON."""
    from coded_aperture_ros.ros import demo_monitor as topics

    sharp, depth_m = snapshot[topics.TRUE_IMAGE], snapshot[topics.DEPTH]
    error = topics.map_error(depth_m, snapshot[topics.CONFIDENCE], snapshot[topics.TRUE_DEPTH])
    return {
        "frame": [*sharp.shape[1::-1]],
        "depth_image": [*depth_m.shape[::-1]],
        "psnr_coded_db": rounded(psnr_db(snapshot[topics.CODED], sharp), 4),
        "psnr_all_in_focus_db": rounded(psnr_db(snapshot[topics.DEBLURRED], sharp), 4),
        "snapshot_depth": {
            name: rounded(value, 4) for name, value in dataclasses.asdict(error).items()
        },
    }


def _median(values: Sequence[float]) -> float | None:

    known = [value for value in values if math.isfinite(value)]
    return rounded(float(np.median(known)), 4) if known else None
