"""What lies between a frame's stamp and its depth beside the work: transport and Python."""

import contextlib
import dataclasses
import json
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from coded_aperture_benchmarks import options
from coded_aperture_benchmarks.run import Row, Suite
from coded_aperture_benchmarks.speed import frame_publisher, idle_nodes
from coded_aperture_benchmarks.speed.node_figures import stream_figures
from coded_aperture_benchmarks.speed.node_processes import Process, listener, wait_for_depth
from coded_aperture_benchmarks.speed.setting import Size
from coded_aperture_ros.core.machine import BusyTime, processor_time_s
from coded_aperture_ros.core.share import demo_camera_file, private_network, shared_memory_suffices
from coded_aperture_ros.core.text_table import columns

_FRAMES = 4
_WARM_UP_S = 1.0
_LAST_RESULTS_S = 0.5
# Way to answer, and whether the frames come from its own process.
_WAYS = tuple((way, same) for same in (False, True) for way in idle_nodes.WAYS)


@dataclasses.dataclass(frozen=True)
class Cell:
    """Frames of one size at one rate; all ways take turns."""

    size: Size
    rate_hz: float
    seconds: float
    repeats: int


def _cells(args: options.Args) -> list[Cell]:
    return [
        Cell(size, rate_hz, args.seconds, args.repeats)
        for size in args.sizes
        for rate_hz in args.rates
    ]


def measure(cell: Cell) -> Row:
    """Measure all ways in turn, a few times: other work then disturbs all of them alike."""
    shared_memory = shared_memory_suffices()
    with tempfile.TemporaryDirectory(prefix="coded_aperture-transport-") as name:
        folder = Path(name)
        environment = {**private_network(shared_memory), "ROS_LOG_DIR": name}
        with _environment(environment):
            _write_inputs(folder, cell.size)
            runs = [
                _run(folder, way, same_process, cell, reliable=not shared_memory)
                for _ in range(cell.repeats)
                for way, same_process in _WAYS
            ]
    return {
        "size": list(cell.size),
        "rate_hz": cell.rate_hz,
        "shared_memory": shared_memory,
        "rows": [_summary(runs, way, same_process) for way, same_process in _WAYS],
    }


def _summary(runs: Sequence[Row], way: str, same_process: bool) -> Row:
    """Medians of the repeats of a way."""
    of_way = [run for run in runs if (run["way"], run["same_process"]) == (way, same_process)]
    medians = {
        key: float(np.median([run[key] for run in of_way]))
        for key in ("latency_ms", "latency_p99_ms", "processor_ms", "received", "other_cores")
    }
    return {"way": way, "same_process": same_process, **medians, "runs": of_way}


def _run(folder: Path, way: str, same_process: bool, cell: Cell, *, reliable: bool) -> Row:
    """Latency from stamp to receipt, and processor time of all processes but the subscriber."""
    frames, camera, log = (folder / name for name in ("frames.npy", "camera.yaml", "sent.json"))
    source = (frames, cell.rate_hz, log) if same_process else ()
    with contextlib.ExitStack() as ending:
        arguments = idle_nodes.arguments(way, camera, *source)
        programs = [ending.enter_context(Process(arguments, folder / f"{way}.log"))]
        if not same_process:
            arguments = frame_publisher.arguments(frames, camera, cell.rate_hz, log)
            programs.append(ending.enter_context(Process(arguments, folder / "publisher.log")))
        onlooker = ending.enter_context(listener(reliable))
        wait_for_depth(onlooker, programs)
        onlooker.listen(_WARM_UP_S, programs)
        begun_ns, before_s, busy_before = time.time_ns(), _processor_s(programs), BusyTime.now()
        own_before_s = time.process_time()
        onlooker.listen(cell.seconds, programs)
        ended_ns, took_s = time.time_ns(), _processor_s(programs) - before_s
        own_s = time.process_time() - own_before_s
        busy = busy_before.cores()
        for program in programs:
            program.interrupt()
        onlooker.listen(_LAST_RESULTS_S, ())
        for program in programs:
            program.end()
    sent_ns = json.loads(log.read_text())["sent_ns"]
    log.unlink()
    figures = stream_figures(sent_ns, onlooker.received, begun_ns, ended_ns)
    seconds = (ended_ns - begun_ns) * 1e-9
    return {
        "way": way,
        "same_process": same_process,
        "latency_ms": figures["latency_ms"]["median"],
        "latency_p99_ms": figures["latency_ms"]["p99"],
        "processor_ms": 1000 * took_s / figures["sent"],
        "received": figures["received"] / figures["sent"],
        "other_cores": max(0.0, busy - (took_s + own_s) / seconds),
    }


def _processor_s(programs: Sequence[Process]) -> float:
    return sum(processor_time_s(program.pid) for program in programs)


def _write_inputs(folder: Path, size: Size) -> None:
    """Write frames of noise, and the demo's camera with as many pixels."""
    rows, columns_ = size
    random = np.random.default_rng(0)
    np.save(folder / "frames.npy", random.integers(256, size=(_FRAMES, *size), dtype=np.uint8))
    camera = yaml.safe_load(demo_camera_file().read_text())
    del camera["sensor"]  # which has so many pixels only
    camera.update(image_width=columns_, image_height=rows)
    (folder / "camera.yaml").write_text(yaml.safe_dump(camera))


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _text(results: Row) -> str:
    described: dict[str, Any] = {
        "": "{name}",
        "latency, ms": "{latency_ms:.2f}",
        "99 %": "{latency_p99_ms:.2f}",
        "times the null node's": "{ratio:.2f}",
        "processor time of a frame, ms": "{processor_ms:.2f}",
        "answered, %": "{answered:.1f}",
        "others' cores": "{other_cores:.2f}",
    }
    tables = []
    for cell in results["cells"]:
        null_ms = {
            row["same_process"]: row["latency_ms"] for row in cell["rows"] if row["way"] == "null"
        }
        rows = [
            {
                **row,
                "name": f"{row['way']}{', frames from its process' if row['same_process'] else ''}",
                "ratio": row["latency_ms"] / null_ms[row["same_process"]],
                "answered": 100 * row["received"],
            }
            for row in cell["rows"]
        ]
        height, width = cell["size"]
        tables.append(f"{width}x{height} at {cell['rate_hz']:g} Hz\n{columns(rows, described)}")
    return "\n\n".join(tables)


SUITE = Suite(
    name="transport",
    description="Time from stamp to depth without the work: the depth node with its pipeline "
    "replaced by a constant map, beside a node of rclpy alone that answers with one; grey frames "
    "in, 32FC1 of their size out, to a subscriber in a third process. Then both again, with the "
    "frames from their own process.",
    examples="""examples:
  640x480 and 1280x720 at 30 and 90 Hz, six minutes:
    python -m coded_aperture_benchmarks transport
""",
    options=(
        options.option(
            "--sizes",
            "of the frames, px",
            [(480, 640), (720, 1280)],
            said="640x480 1280x720",
            type=options.size,
            metavar="WxH",
        ),
        options.option("--rates", "frames per second", [30.0, 90.0], type=float, metavar="HZ"),
        options.option("--seconds", "of each run", 5.0, type=float, metavar="S"),
        options.number("--repeats", 1, 3, "runs of each; medians count"),
        options.JSON,
        options.OUTPUT,
    ),
    cells=_cells,
    measure=measure,
    text=_text,
)
