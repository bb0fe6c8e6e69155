"""`coded_aperture demo`: the whole chain on this machine, measured from outside."""

import argparse
import contextlib
import dataclasses
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coded_aperture_ros.cli.checks import check_output
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.share import share_directory

if TYPE_CHECKING:
    from coded_aperture_ros.nodes.demo_monitor import DemoMonitor, Snapshot

CAMERA_FILE = "demo_camera.yaml"
# What the scene covers, and a little more.
NEAR_M, FAR_M = 2.05, 5.1
LEVELS = 30
RATE_HZ = 12.0
# With the default stride of 8 px the depth node alone would need more than one core at this rate.
DEPTH = {"stride_px": 16, "regularize": "tv", "smoothness": 1.5}
# A robot steers by depth; all-in-focus frames are for people, who need fewer of them.
DEBLUR_RATE_HZ = 2.0
DEBLUR_RANK = 12
RESULTS = ("coded.png", "depth.png", "all_in_focus.png", "summary.json")
NODES = ("camera_driver_node", "depth_node", "deblur_node")

_START_TIMEOUT_S = 60.0
_SNAPSHOT_TIMEOUT_S = 15.0
_REDRAW_S = 0.5
_LINE_S = 5.0
_LAST_LINES = 15
# Niceness counts only within a session (Linux autogroups), so the nodes stay in this one; Ctrl-C
# then reaches them too, which they take as it is meant.
_NICENESS = {"deblur_node": 10}
# Four processes with a segment of 32 MB each.
_SHARED_MEMORY_MB = 140
_RELIABLE_INPUTS = {
    f"qos_overrides./{topic}.subscription.reliability": "reliable"
    for topic in ("image_raw", "depth/image")
}


def add_parser(subparsers: Any) -> None:
    """Add the sub-command to the command line."""
    parser = subparsers.add_parser(
        "demo",
        help="run camera driver, depth and deblurring on a simulated camera",
        description=(
            "Run camera driver (simulating a camera that pans over a real scene), depth node and "
            "deblurring node as three processes over DDS; show rate, latency and accuracy; leave "
            "coded.png, depth.png, all_in_focus.png and summary.json."
        ),
        epilog="example: coded_aperture demo --output /tmp/demo --seconds 10",
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("demo_output"),
        metavar="DIR",
        help="where to put the results (default: %(default)s)",
    )
    parser.add_argument(
        "--seconds",
        type=_seconds,
        default=20.0,
        metavar="N",
        help="how long to measure (default: %(default)g)",
    )
    parser.add_argument(
        "--json", action="store_true", help="print the summary as JSON instead of the table"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the demo."""
    say = _Speaker(sys.stderr if options.json else sys.stdout)
    for name in RESULTS:
        check_output(options.output / name)
    shared_memory = _shared_memory_suffices()
    os.environ.update(_private_network(shared_memory))
    # Without it large best-effort messages are lost; asked for again, they take longer.
    reliability = {} if shared_memory else _RELIABLE_INPUTS
    if not shared_memory:
        say.line(f"/dev/shm has less than {_SHARED_MEMORY_MB} MB: sending images by UDP (slower)")
    # Only now: rclpy reads the environment when it is imported and started.
    from coded_aperture_ros.nodes.demo_monitor import running_monitor

    with (
        _sigterm_like_ctrl_c(),
        tempfile.TemporaryDirectory(prefix="coded_aperture-demo-") as folder,
        Children(Path(folder)) as children,
    ):
        camera_file = share_directory() / "config" / CAMERA_FILE
        camera = {"camera_file": str(camera_file), "source": "simulator", "rate_hz": RATE_HZ}
        children.start("camera_driver_node", camera)  # renders its scene meanwhile
        model = learned_model(camera_file, Path(folder) / "bank.npz", say)
        children.start("depth_node", {**model, **reliability, **DEPTH})
        children.start(
            "deblur_node",
            {**model, **reliability, "max_rate_hz": DEBLUR_RATE_HZ, "rank": DEBLUR_RANK},
        )
        with running_monitor(reliable=not shared_memory) as monitor:
            _wait_for_results(monitor, children, say)
            _measure(monitor, children, say, options.seconds)
            summary = summarise(monitor, options.seconds)
            snapshot = _take_snapshot(monitor, children)
    summary.update(_of_snapshot(snapshot))
    say.line(
        f"PSNR against the sharp scene: {summary['psnr_coded_db']} dB coded, "
        f"{summary['psnr_all_in_focus_db']} dB all in focus"
    )
    write_results(options.output, snapshot, summary)
    say.line(f"results are in {options.output}/")
    if options.json:
        print(json.dumps(summary, indent=2))
    return 0


def learned_model(camera_file: Path, bank_file: Path, say: "_Speaker") -> dict[str, Any]:
    """Learn the bank, and return the parameters of the nodes that use it."""
    from coded_aperture_ros.bank import learn_bank_for_camera, save_bank
    from coded_aperture_ros.optics import load_camera

    started_s = time.monotonic()
    bank = learn_bank_for_camera(load_camera(camera_file), NEAR_M, FAR_M, LEVELS)
    save_bank(bank, bank_file)
    say.line(f"learned a bank of {LEVELS} levels in {time.monotonic() - started_s:.1f} s")
    return {
        "camera_file": str(camera_file),
        "bank": str(bank_file),
        "near_m": NEAR_M,
        "far_m": FAR_M,
    }


class Children:
    """The nodes' processes; none of them outlives the `with` block."""

    def __init__(self, log_folder: Path) -> None:
        self._log_folder = log_folder
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> "Children":
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + 5.0
        for process in self._processes.values():
            try:
                process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def start(self, node: str, parameters: dict[str, Any]) -> None:
        """Start a node in a process of its own."""
        arguments = [
            text
            for name, value in parameters.items()
            for text in ("-p", f"{name}:={json.dumps(value)}")
        ]
        with self._log(node).open("wb") as log:
            process = subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    f"coded_aperture_ros.nodes.{node}",
                    "--ros-args",
                    *arguments,
                ],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        self._processes[node] = process
        os.setpriority(os.PRIO_PROCESS, process.pid, _NICENESS.get(node, 0))

    def check(self) -> None:
        """Raise an `InputError` with the last lines of a node that has ended."""
        for node, process in self._processes.items():
            if process.poll() is not None:
                raise InputError(f"{node} ended with status {process.returncode}:{self.said(node)}")

    def said(self, node: str) -> str:
        """Return the last lines that a node has written."""
        lines = self._log(node).read_text(errors="replace").splitlines()[-_LAST_LINES:]
        return "".join(f"\n    {line}" for line in lines)

    def _log(self, node: str) -> Path:
        return self._log_folder / f"{node}.log"


def summarise(monitor: "DemoMonitor", seconds: float) -> dict[str, Any]:
    """Return what was measured, ready for JSON; latencies are from the stamp to the reception."""
    from coded_aperture_ros.nodes import demo_monitor

    summary: dict[str, Any] = {"seconds": seconds, "levels": LEVELS}
    for name, topic, node in (
        ("camera", demo_monitor.CODED, None),
        ("depth", demo_monitor.DEPTH, "depth_node"),
        ("deblur", demo_monitor.DEBLURRED, "deblur_node"),
    ):
        figures = monitor.figures(topic)
        entry: dict[str, Any] = {
            "frames": figures.frames,
            "rate_hz": round(figures.rate_hz, 3),
            "rates_per_second_hz": figures.rates_hz,
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
    from coded_aperture_ros.files import atomic_output
    from coded_aperture_ros.images import SRGB, depth_picture, write_image

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


class _Speaker:
    """Prints progress: a table redrawn in place on a terminal, a line now and then elsewhere."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self.redraws = stream.isatty()
        self._drawn = 0

    def line(self, text: str) -> None:
        self._drawn = 0
        print(text, file=self._stream, flush=True)

    def table(self, lines: Sequence[str]) -> None:
        if self._drawn:
            print(f"\x1b[{self._drawn}A", end="", file=self._stream)
        for text in lines:
            print(f"{text}\x1b[K" if self.redraws else text, file=self._stream)
        self._stream.flush()
        self._drawn = len(lines) if self.redraws else 0


def _wait_for_results(monitor: "DemoMonitor", children: Children, say: _Speaker) -> None:
    from coded_aperture_ros.nodes import demo_monitor

    say.line(f"starting {', '.join(NODES)} (ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']})")
    deadline = time.monotonic() + _START_TIMEOUT_S
    while not all(monitor.received(t) for t in (demo_monitor.DEPTH, demo_monitor.DEBLURRED)):
        children.check()
        if time.monotonic() > deadline:
            said = "".join(f"\n  {node} said:{children.said(node)}" for node in NODES)
            raise InputError(f"no depth and all-in-focus frames in {_START_TIMEOUT_S:g} s{said}")
        time.sleep(0.1)


def _measure(monitor: "DemoMonitor", children: Children, say: _Speaker, seconds: float) -> None:
    period_s = _REDRAW_S if say.redraws else _LINE_S
    monitor.begin()
    started_s = time.monotonic()
    due_s = started_s + period_s
    while (now_s := time.monotonic()) < started_s + seconds:
        children.check()
        if now_s >= due_s:
            due_s += period_s
            elapsed_s = now_s - started_s
            say.table([f"{elapsed_s:.0f} of {seconds:g} s", *table(summarise(monitor, elapsed_s))])
        time.sleep(0.05)
    say.table([f"{seconds:g} s", *table(summarise(monitor, seconds))])


def _take_snapshot(monitor: "DemoMonitor", children: Children) -> "Snapshot":
    monitor.want_true_image()
    deadline = time.monotonic() + _SNAPSHOT_TIMEOUT_S
    while (snapshot := monitor.snapshot()) is None:
        children.check()
        if time.monotonic() > deadline:
            raise InputError(
                f"no frame came through all nodes in {_SNAPSHOT_TIMEOUT_S:g} s: too little "
                "processor time, or shared memory (/dev/shm) too small"
            )
        time.sleep(0.1)
    return snapshot


def _of_snapshot(snapshot: "Snapshot") -> dict[str, Any]:
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


def _private_network(shared_memory: bool) -> dict[str, str]:
    """Return the environment that keeps the demo's topics apart from any robot's."""
    for name in ("ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "ROS_NAMESPACE", "ROS_DISCOVERY_SERVER"):
        os.environ.pop(name, None)
    environment = {
        # 1 to 100 keep clear of the ports that Linux hands out by itself; 0 is the default.
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    if shared_memory:
        profiles = share_directory() / "config" / "fastdds_shared_memory.xml"
        environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profiles)
    return environment


def _shared_memory_suffices(folder: str = "/dev/shm") -> bool:
    """Return whether there is room for the segments; containers often have 64 MB only."""
    try:
        status = os.statvfs(folder)
    except OSError:
        return False
    return status.f_bavail * status.f_frsize >= _SHARED_MEMORY_MB * 2**20


@contextlib.contextmanager
def _sigterm_like_ctrl_c() -> Iterator[None]:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _seconds(text: str) -> float:
    value = float(text)
    if not 1.0 <= value <= 86_400.0:
        raise argparse.ArgumentTypeError("expected 1 to 86400 seconds")
    return value


def _number(value: float) -> float | None:
    """Return a number that JSON can hold."""
    return round(value, 4) if math.isfinite(value) else None


def _median(values: Sequence[float]) -> float | None:
    import numpy as np

    known = [value for value in values if math.isfinite(value)]
    return _number(float(np.median(known))) if known else None
