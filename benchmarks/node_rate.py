"""The depth node at the rate of a camera, over DDS on this machine, beside the machine's speed.

One process publishes coded frames, stamped at the moment of publication; the depth node runs as a
program of its own, as on a robot; this process subscribes to its depth images and measures them by
their stamps. Beside that stands what the node says about itself on /diagnostics.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from coded_aperture_benchmarks.speed import frame_publisher
from coded_aperture_benchmarks.speed.machine import machine_rates
from coded_aperture_benchmarks.speed.node_figures import (
    COUNTERS,
    node_figures,
    process_figures,
    rounded_or_none,
    run_figures,
    stolen_s,
    stream_figures,
)
from coded_aperture_benchmarks.speed.node_processes import Process, listener, wait_for_depth
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.interrupt import sigterm_like_ctrl_c
from coded_aperture_ros.core.machine import BusyTime, processor_time_s
from coded_aperture_ros.core.share import (
    SHARED_MEMORY_MB,
    demo_camera_file,
    private_network,
    shared_memory_suffices,
)
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.likelihood.bank import DEFAULT_LEVEL_COUNT
from coded_aperture_ros.simulation import MOTORCYCLE_RANGE_M

# The simulated camera of the demo, and where its scene is.
FRAMES = 8

# What was sent last has come by then, or never will.
_LAST_RESULTS_S = 1.0
_INTERRUPTED = 130


def render_frames(camera_file: Path) -> NDArray[np.uint8]:
    """Return different views of a real scene, coded by the camera's mask, with noise; mono8."""
    from coded_aperture_ros.io.messages import luminance, pixels_from_frame
    from coded_aperture_ros.optics import load_camera
    from coded_aperture_ros.simulation import PanningScene, motorcycle_scene
    from coded_aperture_ros.simulation.exposure import sensor_of_camera_file

    camera = load_camera(camera_file)
    panning = PanningScene(motorcycle_scene(), camera, period_s=2.0 * FRAMES)
    sensor, random = sensor_of_camera_file(camera_file, camera), np.random.default_rng(0)
    views = (luminance(panning.frame(float(time_s)).coded) for time_s in range(FRAMES))
    return np.stack([pixels_from_frame(sensor.expose(view, random), "mono8") for view in views])


def node_arguments(camera_file: Path, reliable: bool, given: Sequence[str]) -> list[str]:
    """Return the command line of the depth node; parameters `given` as NAME:=VALUE come last."""
    near_m, far_m = MOTORCYCLE_RANGE_M
    parameters = [
        f"camera_file:={json.dumps(str(camera_file))}",
        f"near_m:={near_m}",
        f"far_m:={far_m}",
        f"learn.level_count:={DEFAULT_LEVEL_COUNT}",
    ]
    if reliable:
        parameters.append("qos_overrides./image_raw.subscription.reliability:=reliable")
    parameters = [text for text in parameters if not _is_given(text, given)] + list(given)
    arguments = [text for parameter in parameters for text in ("-p", parameter)]
    return ["-m", "coded_aperture_ros.ros.programs", "depth_node", "--ros-args", *arguments]


def _is_given(parameter: str, given: Sequence[str]) -> bool:
    name = parameter.partition(":=")[0]
    return any(other.partition(":=")[0] == name for other in given)


def measure(
    rate_hz: float,
    seconds: float,
    *,
    folder: Path,
    warm_up_s: float = 5.0,
    reliable: bool = False,
    parameters: Sequence[str] = (),
) -> dict[str, Any]:
    """Run publisher and depth node, and measure the node.

    Parameters
    ----------
    rate_hz : float
        Of the frames.
    seconds : float
        How long to measure.
    folder : Path
        Holds frames.npy, made by `render_frames`; for temporary files.
    warm_up_s : float
        From the first depth images to the beginning of the measurement.
    reliable : bool
        Ask for lost images again.
    parameters : sequence of str
        Further ones of the node, as NAME:=VALUE.
    """
    camera_file = demo_camera_file()
    sent_file = folder / "sent.json"
    publishing = frame_publisher.arguments(folder / "frames.npy", camera_file, rate_hz, sent_file)
    arguments = node_arguments(camera_file, reliable, parameters)
    # Beside other programs it is what they leave, and swings: before and after.
    threads = thread_count(0)
    gflop_before = machine_rates(threads).gemm_gflop_s
    with (
        Process(arguments, folder / "depth_node.log") as node,
        Process(publishing, folder / "publisher.log") as frames,
        listener(reliable) as onlooker,
    ):
        wait_for_depth(onlooker, (node, frames))
        onlooker.listen(warm_up_s, (node, frames))
        began, used_before_s = BusyTime.now(), _used_s(node, frames)
        begun_ns, before, stolen_before_s = time.time_ns(), process_figures(node.pid), stolen_s()
        onlooker.listen(seconds, (node, frames))
        ended_ns, after, stolen_after_s = time.time_ns(), process_figures(node.pid), stolen_s()
        other_cores = began.cores() - (_used_s(node, frames) - used_before_s) / seconds
        frames.interrupt()  # and receive meanwhile, so that the last frames are not late
        onlooker.listen(_LAST_RESULTS_S, (node,))
        frames.end()
        if not sent_file.exists():
            raise InputError(f"the publisher did not end as it should:{frames.said()}")
    sent = json.loads(sent_file.read_text())
    sent_file.unlink()
    late_ms_p99 = rounded_or_none(lambda late: np.percentile(late, 99), sent["late_ms"])
    return {
        "rate_hz": rate_hz,
        "seconds": seconds,
        "parameters": list(parameters),
        "publisher": {"late_ms_p99": late_ms_p99, "left_out": sent["left_out"]},
        "gflop_s": [round(rate, 1) for rate in (gflop_before, machine_rates(threads).gemm_gflop_s)],
        "other_cores": round(max(other_cores, 0.0), 2),
        "stolen_cores": round((stolen_after_s - stolen_before_s) / seconds, 3),
        "depth": stream_figures(sent["sent_ns"], onlooker.received, begun_ns, ended_ns),
        "node": node_figures(onlooker.statuses, sent["sent_ns"], begun_ns, ended_ns),
        "process": run_figures(before, after, seconds),
    }


def _used_s(*processes: Process) -> float:
    """Processor time of the benchmark and its processes so far, s."""
    return time.process_time() + sum(processor_time_s(each.pid) for each in processes)


def table(runs: Sequence[dict[str, Any]]) -> list[str]:
    """Return the figures as the lines of a table with a column for each rate."""
    columns = [dict(rows(run)) for run in runs]
    names = list(dict.fromkeys(name for column in columns for name in column))
    cells = [["", *(f"{run['rate_hz']:g} Hz" for run in runs)]]
    cells += [[name, *(str(column.get(name, "")) for column in columns)] for name in names]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = [
        "| " + " | ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) + " |"
        for row in cells
    ]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return lines


def rows(run: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the rows of one rate: a name and a value."""
    depth, node, process = run["depth"], run["node"], run["process"]
    latency = depth["latency_ms"]
    yield "frames sent", depth["sent"]
    yield "publisher late, p99 ms", run["publisher"]["late_ms_p99"]
    yield "publisher left out", run["publisher"]["left_out"]
    before, after = run["gflop_s"]
    yield "float32 matrix products before and after, GFLOP/s", f"{before:g} {after:g}"
    yield "cores that other programs took", run["other_cores"]
    yield "processors that the host withheld", run["stolen_cores"]
    yield "depth received", depth["received"]
    yield "depth received, Hz", depth["received_hz"]
    yield "never came", depth["never_came"]
    yield "never came, most in a row", depth["never_came_in_a_row"]
    yield "longest gap, ms", depth["longest_gap_ms"]
    for name, value in latency.items():
        yield f"stamp to receipt, {name.replace('_', ' ')}, ms", value
    yield "node: time between its first and last report, s", node["seconds"]
    yield "node: frames sent in that time", node["sent"]
    for name in COUNTERS:
        yield f"node: frames {name}", node[name]
    yield "node: cores", process["cores"]
    yield "node: RSS at the end, MB", process["rss_end_mb"]
    yield "node: RSS growth, MB", process["rss_growth_mb"]
    yield "node: growth of anonymous memory, MB", process["anonymous_growth_mb"]
    for key, value in node["reported"].items():
        if key not in COUNTERS:
            yield f"node reports {key}", value


def run_benchmark(args: argparse.Namespace) -> list[dict[str, Any]]:
    """Measure all rates in turn."""
    shared_memory = shared_memory_suffices()
    os.environ.update(private_network(shared_memory))
    if not shared_memory:
        message = f"/dev/shm has less than {SHARED_MEMORY_MB} MB: sending images by UDP (slower)"
        print(message, file=sys.stderr)
    with tempfile.TemporaryDirectory(prefix="coded_aperture-node_rate-") as name:
        folder = Path(name)
        os.environ.setdefault("ROS_LOG_DIR", name)
        print("rendering frames", file=sys.stderr)
        np.save(folder / "frames.npy", render_frames(demo_camera_file()))
        runs = []
        for rate_hz in args.rates:
            print(f"{rate_hz:g} Hz for {args.seconds:g} s", file=sys.stderr)
            run = measure(
                rate_hz,
                args.seconds,
                folder=folder,
                warm_up_s=args.warm_up,
                reliable=not shared_memory,
                parameters=args.parameters,
            )
            runs.append(run)
    return runs


def parse_arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        *("--rates", "--rate"),
        type=_positive,
        nargs="+",
        default=[30.0],
        metavar="HZ",
        help="frames per second, one measurement each (default 30)",
    )
    length = parser.add_mutually_exclusive_group()
    length.add_argument(
        *("--seconds",), type=_positive, default=60.0, help="how long to measure (default 60)"
    )
    length.add_argument(
        *("--minutes",), type=_minutes, dest="seconds", metavar="M", help="the same, in minutes"
    )
    parser.add_argument(
        *("--warm-up",), type=_positive, default=5.0, metavar="SECONDS", help="before (default 5)"
    )
    parser.add_argument(
        *("-p", "--parameter"),
        dest="parameters",
        type=_parameter,
        action="append",
        default=[],
        metavar="NAME:=VALUE",
        help="parameter of the depth node, such as stride_px:=16; may be repeated",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    return parser.parse_args()


def _positive(text: str) -> float:
    value = float(text)
    if not 0.1 <= value <= 86_400.0:
        raise argparse.ArgumentTypeError("expected 0.1 to 86400")
    return value


def _minutes(text: str) -> float:
    return 60.0 * _positive(text)


def _parameter(text: str) -> str:
    if ":=" not in text:
        raise argparse.ArgumentTypeError("expected NAME:=VALUE")
    return text


def main() -> int:
    """Print the table."""
    args = parse_arguments()
    try:
        with sigterm_like_ctrl_c():
            runs = run_benchmark(args)
    except (InputError, OSError) as error:
        print(f"node_rate: error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return _INTERRUPTED
    print(json.dumps(runs, indent=2) if args.json else "\n".join(table(runs)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
