"""The benchmark beside stereo matching and a monocular network: every way is timed."""

import json

import numpy as np
import pytest
from coded_aperture_benchmarks.__main__ import main_of_all
from coded_aperture_benchmarks.methods.monocular import Monocular, unsupported_reason

WAYS = 8 if unsupported_reason() else 9


def test_all_ways_take_turns(capsys):
    words = ["against", "--size", "128x80", "--threads", "1", "--frames", "2", "--json"]
    assert main_of_all(words) == 0
    results = json.loads(capsys.readouterr().out)
    (found,) = results["cells"]
    assert found["threads"] == 1 and found["gflop_s"] > 0
    ways = [row["way"] for row in found["rows"]]
    assert len(ways) == len(set(ways)) == WAYS
    assert all(0 < row["ms"] <= row["p90_ms"] for row in found["rows"])
    assert all(row["processor_ms"] > 0 and row["given"] for row in found["rows"])


def test_the_table_has_a_row_for_each(capsys):
    words = ["against", "--size", "128x80", "--threads", "1", "--frames", "1"]
    assert main_of_all(words) == 0
    printed = capsys.readouterr().out
    assert "1 thread(s)" in printed and "64 disparities" in printed
    assert len(printed.splitlines()) == 3 + WAYS


@pytest.mark.skipif(bool(unsupported_reason()), reason="needs onnx and onnxruntime")
def test_the_network_is_of_the_size_of_midas_small():
    network = Monocular(threads=1)
    assert network.model.parameters == pytest.approx(16.6e6, rel=0.02)
    picture = np.random.default_rng(0).integers(256, size=(48, 64, 3), dtype=np.uint8)
    found = network(picture)
    assert found.shape == (48, 64) and np.isfinite(found).all()
