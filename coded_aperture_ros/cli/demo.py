"""`coded_aperture demo`: the whole chain on this machine, measured from outside."""

import dataclasses
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coded_aperture_ros.calibration.psf.optics_limits import with_optics_limits
from coded_aperture_ros.cli.command import Command, argument
from coded_aperture_ros.cli.demo_cores import SharedCores
from coded_aperture_ros.cli.demo_processes import Children
from coded_aperture_ros.cli.demo_report import (
    RESULTS,
    Speaker,
    cores_line,
    figures_of_snapshot,
    stream_figures,
    summarise,
    table,
    write_results,
)
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.files import check_output
from coded_aperture_ros.core.machine import product_rates
from coded_aperture_ros.core.share import (
    SHARED_MEMORY_MB,
    demo_camera_file,
    private_network,
    shared_memory_suffices,
)
from coded_aperture_ros.core.workers import processors, thread_count
from coded_aperture_ros.likelihood.bank import DEFAULT_LEVEL_COUNT, learn_bank_for_camera, save_bank
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.simulation import MOTORCYCLE_RANGE_M

if TYPE_CHECKING:
    from coded_aperture_ros.ros.demo_monitor import DemoMonitor

RATE_HZ = 12.0
# A robot steers by depth; all-in-focus frames are for people, who need fewer of them.
DEBLUR = {"frames.max_rate_hz": 3.0}
NODES = ("camera_driver_node", "depth_node", "deblur_node")

# On a machine that has as many tasks as processors, or fewer.
_START_TIMEOUT_S = 60.0
_SNAPSHOT_TIMEOUT_S = 15.0
_NO_RESULTS = "no depth and all-in-focus frames"
_NO_SNAPSHOT = (
    "too little processor time, or shared memory (/dev/shm) too small: no frame through all nodes"
)
# Depth without deblurring, and with no subscriber to anything else.
_ALONE_S = 5.0
_REDRAW_S = 0.5
_LINE_S = 5.0
_RELIABLE_INPUTS = {
    f"qos_overrides./{topic}.subscription.reliability": "reliable"
    for topic in ("image_raw", "depth/image")
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arguments:
    """Arguments of `demo`."""

    output: Path = argument("where to put the results", Path("demo_output"), written="--output DIR")
    seconds: float = argument(
        "how long to measure", 20.0, written="--seconds N", unit="s", minimum=1, maximum=86_400
    )
    json: bool = argument("print the summary as JSON instead of the table", False)


def run(args: Arguments) -> int:
    """Run the demo; return the exit status."""
    say = Speaker(sys.stderr if args.json else sys.stdout)
    check_output(args.output / name for name in RESULTS)
    shared_memory = shared_memory_suffices()
    os.environ.update(private_network(shared_memory))
    # Without it large best-effort messages are lost; asked for again, they take longer.
    reliability = {} if shared_memory else _RELIABLE_INPUTS
    if not shared_memory:
        say.line(f"/dev/shm has less than {SHARED_MEMORY_MB} MB: sending images by UDP (slower)")
    # Only now: rclpy reads the environment when it is imported and started.
    from coded_aperture_ros.ros.demo_monitor import DEPTH, running_monitor

    threads = thread_count(0)
    machine = {"threads": threads, "gflop_s": round(max(product_rates(threads)), 1)}
    with (
        tempfile.TemporaryDirectory(prefix="coded_aperture-demo-") as folder,
        Children(Path(folder)) as children,
    ):
        camera_file = demo_camera_file()
        camera = {"camera_file": str(camera_file), "source": "simulator", "rate_hz": RATE_HZ}
        children.start("camera_driver_node", camera)  # renders its scene meanwhile
        model = {**learned_model(camera_file, Path(folder) / "bank.npz", say), **reliability}
        children.start("depth_node", model)
        children.start("deblur_node", {**model, **DEBLUR})
        say.line(f"starting {', '.join(NODES)} (ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']})")
        with running_monitor(reliable=not shared_memory) as monitor:
            _wait(monitor.has_results, children, _START_TIMEOUT_S, _NO_RESULTS)
            cores = SharedCores(children.processor_s)
            _measure(monitor, children, say, args.seconds)
            summary = {**summarise(monitor, args.seconds), "machine": machine}
            summary["cores"] = cores.shares()
            monitor.want_true_image()
            snapshot = _wait(monitor.snapshot, children, _SNAPSHOT_TIMEOUT_S, _NO_SNAPSHOT)
        children.end("deblur_node")
        with running_monitor(reliable=not shared_memory, topics=(DEPTH,)) as monitor:
            _wait(monitor.has_results, children, _START_TIMEOUT_S, "no depth")
            summary["depth_alone"] = _measure_alone(monitor, children)
    say.line(cores_line(summary))
    summary.update(levels=DEFAULT_LEVEL_COUNT, **figures_of_snapshot(snapshot))
    say.line(
        f"PSNR against the sharp scene: {summary['psnr_coded_db']:.1f} dB coded, "
        f"{summary['psnr_all_in_focus_db']:.1f} dB all in focus"
    )
    write_results(args.output, snapshot, summary)
    say.line(f"results are in {args.output}/: open {args.output / 'index.html'}")
    if args.json:
        print(json.dumps(summary, indent=2))
    return 0


def learned_model(camera_file: Path, bank_file: Path, say: Speaker) -> dict[str, Any]:
    """Learn the bank, and return the parameters of the nodes that use it."""
    started_s = time.monotonic()
    bank = learn_bank_for_camera(load_camera(camera_file), *MOTORCYCLE_RANGE_M)
    save_bank(with_optics_limits(bank), bank_file)
    say.line(f"learned a bank of {bank.levels} levels in {time.monotonic() - started_s:.1f} s")
    return {"camera_file": str(camera_file), "bank": str(bank_file)}


def _wait(found: Callable[[], Any], children: Children, timeout_s: float, missing: str) -> Any:
    """Return what is found once it is there; a machine with much else to do gets more time."""
    started_s = time.monotonic()
    while not (result := found()):
        children.check()
        waited_s = time.monotonic() - started_s
        if waited_s > timeout_s * max(1.0, os.getloadavg()[0] / processors()):
            said = "".join(f"\n  {node} said:{children.said(node)}" for node in NODES)
            raise InputError(f"{missing} in {waited_s:.0f} s{said}")
        time.sleep(0.1)
    return result


def _measure(monitor: "DemoMonitor", children: Children, say: Speaker, seconds: float) -> None:
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


def _measure_alone(monitor: "DemoMonitor", children: Children) -> dict[str, Any]:
    """Figures of depth while the camera and its node have the machine to themselves."""
    from coded_aperture_ros.ros.demo_monitor import DEPTH

    monitor.begin()
    cores = SharedCores(children.processor_s)
    ends_s = time.monotonic() + _ALONE_S
    while time.monotonic() < ends_s:
        children.check()
        time.sleep(0.05)
    figures = stream_figures(monitor.arrivals(DEPTH), _ALONE_S)
    return {"seconds": _ALONE_S, **figures, "cores": cores.shares()}


COMMAND = Command(
    Arguments,
    run,
    description="Run camera driver (simulating a camera that pans over a real scene), depth "
    "node and deblurring node as three processes over DDS; show rate, latency and accuracy, and "
    "who took the processors; then the rate of depth without deblurring; leave pictures, "
    "summary.json and a page with both beside the truth, index.html.",
    examples="example:\n  coded_aperture demo --output results --seconds 10\n",
)
