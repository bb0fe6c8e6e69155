"""The benchmark of transport: both nodes answer, with frames from outside and from inside."""

import json

import pytest
from coded_aperture_benchmarks.__main__ import main_of_all
from coded_aperture_benchmarks.speed.idle_nodes import IdlePipeline

pytest.importorskip("rclpy")


@pytest.mark.serial
@pytest.mark.slow
def test_all_ways_answer(capsys):
    words = ["transport", "--sizes", "128x96", "--rates", "20", "--seconds", "1", "--repeats", "1"]
    assert main_of_all([*words, "--json"]) == 0
    (cell,) = json.loads(capsys.readouterr().out)["cells"]
    assert cell["size"] == [96, 128] and cell["rate_hz"] == 20
    ways = {(row["way"], row["same_process"]) for row in cell["rows"]}
    assert len(ways) == len(cell["rows"]) == 4
    for row in cell["rows"]:
        assert 0 < row["latency_ms"] <= row["latency_p99_ms"]
        assert row["processor_ms"] > 0 and row["received"] > 0.5


def test_the_idle_pipeline_answers_with_a_constant_map():
    pipeline = IdlePipeline()
    estimate = pipeline(None, (4, 6))
    assert estimate.depth_m.shape == (4, 6) and (estimate.depth_m == 1).all()
    assert pipeline(None, (4, 6)) is estimate
