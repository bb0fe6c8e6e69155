"""The benchmark of the depth node at rate: what it makes of what it has measured."""

import importlib.util
import os
import sys
import time
from pathlib import Path

import pytest
from waiting import run_program

from coded_aperture_ros.core.errors import InputError


@pytest.fixture(scope="module")
def benchmark(checkout):
    path = checkout / "benchmarks" / "node_rate.py"
    spec = importlib.util.spec_from_file_location("node_rate", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_frames_that_never_came_are_counted(benchmark):
    ms = 1_000_000
    sent = [0, *(number * 100 * ms for number in range(1, 11)), 5000 * ms]
    received = {stamp: stamp + 40 * ms for stamp in sent if stamp not in (300 * ms, 400 * ms)}
    figures = benchmark.stream_figures(sent, received, 100 * ms, 1100 * ms)
    assert (figures["sent"], figures["received"], figures["never_came"]) == (10, 8, 2)
    assert figures["received_hz"] == 8.0
    assert figures["never_came_in_a_row"] == 2
    assert figures["never_came_at_s"] == [0.2, 0.3]
    assert figures["longest_gap_ms"] == 300.0
    assert set(figures["latency_ms"].values()) == {40.0}


def test_a_latency_that_grows_is_seen(benchmark):
    sent = [number * 10_000_000 for number in range(100)]
    received = {stamp: stamp + stamp // 10 for stamp in sent}
    latency = benchmark.stream_figures(sent, received, 0, 10**9)["latency_ms"]
    assert latency["median_first_quarter"] < latency["median"] < latency["median_last_quarter"]


def test_nothing_received_is_no_fault_of_the_benchmark(benchmark):
    figures = benchmark.stream_figures([1, 2, 3], {}, 0, 10**9)
    assert (figures["received"], figures["never_came_in_a_row"]) == (0, 3)
    assert figures["latency_ms"]["median"] is None


def test_the_nodes_counters_are_differences_and_the_rest_is_what_it_said_last(benchmark):
    statuses = [
        (number * 10**9, {"received": str(30 * number), "processed": "0", "rate_hz": str(number)})
        for number in range(10)
    ]
    sent = [number * 10**8 for number in range(100)]
    figures = benchmark.node_figures(statuses, sent, 2 * 10**9, 7 * 10**9)
    assert (figures["seconds"], figures["sent"]) == (4.0, 40)
    assert (figures["received"], figures["processed"], figures["dropped"]) == (120, 0, 0)
    assert figures["reported"]["rate_hz"] == "6"
    assert benchmark.node_figures([], sent, 0, 1)["reported"] == {}


def test_a_process_is_measured(benchmark):
    figures = benchmark.process_figures(os.getpid())
    assert figures["rss_mb"] >= figures["anonymous_mb"] > 1
    assert figures["processor_s"] > 0


def test_given_parameters_replace_the_benchmarks_own(benchmark, tmp_path):
    arguments = benchmark.node_arguments(tmp_path, True, ["levels:=8", "stride_px:=16"])
    assert "levels:=8" in arguments and "stride_px:=16" in arguments
    assert sum(text.startswith("levels:=") for text in arguments) == 1


def test_a_process_does_not_outlive_its_block(benchmark, tmp_path):
    with benchmark.Process(["-c", "import time; time.sleep(60)"], tmp_path / "a.log") as process:
        process.check()
    assert not Path(f"/proc/{process.pid}").exists()


def test_a_process_that_ends_is_told_with_what_it_said(benchmark, tmp_path):
    with (
        pytest.raises(InputError, match=r"b ended with status 3:\s+why"),
        benchmark.Process(["-c", "print('why'); exit(3)"], tmp_path / "b.log") as process,
    ):
        while True:
            process.check()
            time.sleep(0.01)


@pytest.mark.serial
@pytest.mark.slow
def test_it_measures_a_node(checkout):
    command = [sys.executable, str(checkout / "benchmarks" / "node_rate.py")]
    options = ["--rates", "5", "--seconds", "3", "--warm-up", "1", "-p", "stride_px:=32"]
    done = run_program(*command, *options, timeout_s=120)
    assert done.returncode == 0, done.stderr
    values = dict(
        [cell.strip() for cell in line.split("|")[1:3]] for line in done.stdout.splitlines()
    )
    assert int(values["depth received"]) > 5
    assert float(values["stamp to receipt, median, ms"]) > 0
    assert "node reports work_median_ms" in values


def test_usage_is_explained(checkout):
    command = [sys.executable, str(checkout / "benchmarks" / "node_rate.py"), "-p", "stride_px"]
    done = run_program(*command)
    assert done.returncode == 2 and "NAME:=VALUE" in done.stderr
