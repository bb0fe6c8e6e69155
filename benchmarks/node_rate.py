"""The depth node at the rate of a camera, over DDS on this machine.

One process publishes coded frames, stamped at the moment of publication; the depth node runs as a
program of its own, as on a robot; this process subscribes to its depth images and measures them by
their stamps. Beside that stands what the node says about itself on /diagnostics.
"""

import argparse
import contextlib
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from coded_aperture_benchmarks.speed.node_figures import (
    COUNTERS,
    node_figures,
    process_figures,
    rounded_or_none,
    run_figures,
    stolen_s,
    stream_figures,
)
from coded_aperture_benchmarks.speed.node_processes import (
    Process,
    listener,
    ros_node,
    wait_for_depth,
)
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.interrupt import sigterm_like_ctrl_c
from coded_aperture_ros.core.share import (
    SHARED_MEMORY_MB,
    private_network,
    share_directory,
    shared_memory_suffices,
)
from coded_aperture_ros.likelihood.bank import DEFAULT_LEVEL_COUNT
from coded_aperture_ros.simulation import MOTORCYCLE_RANGE_M

# The simulated camera of the demo, and where its scene is.
CAMERA_FILE = "demo_camera.yaml"
FRAMES = 8

# What was sent last has come by then, or never will.
_LAST_RESULTS_S = 1.0
_INTERRUPTED = 130


# --- The publisher's process ------------------------------------------------------------------


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


def publish_frames(frames_file: Path, camera_file: Path, rate_hz: float, log_file: Path) -> int:
    """Publish frames in a loop until SIGINT, then write down when; return the exit status.

    The deadlines are those of a steady clock and do not depend on each other. Like a camera, the
    publisher leaves a frame out rather than sending two at once to catch up.
    """
    stopping: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: stopping.append(number))
    sent_ns: list[int] = []
    late_ms: list[float] = []
    left_out = 0
    with publisher(frames_file, camera_file) as publish:
        period_s = 1.0 / rate_hz
        begun_s, turn = time.monotonic(), 0
        while not stopping:
            due_s = begun_s + turn * period_s
            time.sleep(max(due_s - time.monotonic(), 0.0))
            late_ms.append(1000 * (time.monotonic() - due_s))
            sent_ns.append(publish(len(sent_ns)))
            turn, before = max(turn + 1, int((time.monotonic() - begun_s) / period_s)), turn
            left_out += turn - before - 1
    log = {"sent_ns": sent_ns, "late_ms": late_ms, "left_out": left_out}
    log_file.write_text(json.dumps(log))
    return 0


@contextlib.contextmanager
def publisher(frames_file: Path, camera_file: Path) -> Iterator[Any]:
    """Run a node that publishes; yield a function that sends a frame and returns its stamp."""
    import rclpy
    from sensor_msgs.msg import CameraInfo, Image
    from std_msgs.msg import Header

    from coded_aperture_ros.optics import load_camera
    from coded_aperture_ros.ros.messages import camera_info_from_camera, image_from_array
    from coded_aperture_ros.ros.topics import Outputs

    with ros_node("frame_publisher") as (node, _):
        header = Header(frame_id="camera_optical_frame")
        info = camera_info_from_camera(load_camera(camera_file), header)
        images = [image_from_array(pixels, "mono8", header) for pixels in np.load(frames_file)]
        outputs = Outputs(node, {"image_raw": Image, "camera_info": CameraInfo}, None)
        outputs.open()

        def publish(number: int) -> int:
            image = images[number % len(images)]
            now_ns = time.time_ns()
            stamp = rclpy.time.Time(nanoseconds=now_ns).to_msg()
            image.header.stamp = info.header.stamp = stamp
            outputs.send("image_raw", image)
            outputs.send("camera_info", info)
            return now_ns

        yield publish


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


# --- The benchmark ----------------------------------------------------------------------------


def _publishing(frames_file: Path, rate_hz: float, sent_file: Path) -> list[str]:
    """Return the command line of the publisher, this program."""
    program = [str(Path(__file__).resolve()), "--publish", str(frames_file)]
    return [*program, "--rates", str(rate_hz), "--sent", str(sent_file)]


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
    camera_file = share_directory() / "config" / CAMERA_FILE
    sent_file = folder / "sent.json"
    publishing = _publishing(folder / "frames.npy", rate_hz, sent_file)
    arguments = node_arguments(camera_file, reliable, parameters)
    with (
        Process(arguments, folder / "depth_node.log") as node,
        Process(publishing, folder / "publisher.log") as frames,
        listener(reliable) as onlooker,
    ):
        wait_for_depth(onlooker, (node, frames))
        onlooker.listen(warm_up_s, (node, frames))
        begun_ns, before, stolen_before_s = time.time_ns(), process_figures(node.pid), stolen_s()
        onlooker.listen(seconds, (node, frames))
        ended_ns, after, stolen_after_s = time.time_ns(), process_figures(node.pid), stolen_s()
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
        "stolen_cores": round((stolen_after_s - stolen_before_s) / seconds, 3),
        "depth": stream_figures(sent["sent_ns"], onlooker.received, begun_ns, ended_ns),
        "node": node_figures(onlooker.statuses, sent["sent_ns"], begun_ns, ended_ns),
        "process": run_figures(before, after, seconds),
    }


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
        np.save(folder / "frames.npy", render_frames(share_directory() / "config" / CAMERA_FILE))
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
    parser.add_argument(
        *("--seconds",), type=_positive, default=60.0, help="how long to measure (default 60)"
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
    # This program is also the publisher that it starts.
    parser.add_argument("--publish", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--sent", type=Path, help=argparse.SUPPRESS)
    return parser.parse_args()


def _positive(text: str) -> float:
    value = float(text)
    if not 0.1 <= value <= 86_400.0:
        raise argparse.ArgumentTypeError("expected 0.1 to 86400")
    return value


def _parameter(text: str) -> str:
    if ":=" not in text:
        raise argparse.ArgumentTypeError("expected NAME:=VALUE")
    return text


def main() -> int:
    """Print the table."""
    args = parse_arguments()
    if args.publish:
        camera_file = share_directory() / "config" / CAMERA_FILE
        return publish_frames(args.publish, camera_file, args.rates[0], args.sent)
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
