"""The benchmark of a GPU: it runs on the processor, too, and says where there is no GPU."""

import json
from importlib.util import find_spec

import pytest
from coded_aperture_benchmarks.__main__ import main_of_all

WORDS = ["gpu", "--device", "cpu", "--sizes", "128x96", "--frames", "1"]


def has_cuda():
    if find_spec("torch") is None:
        return False
    import torch

    return torch.cuda.is_available()


def test_no_gpu_is_said_in_one_line(capsys):
    if has_cuda():
        pytest.skip("has a CUDA device")
    assert main_of_all(["gpu"]) == 1
    printed = capsys.readouterr()
    assert printed.out == "" and len(printed.err.splitlines()) == 1
    assert "--device cuda: " in printed.err and "--device cpu" in printed.err


def test_all_kinds_of_frames_are_compared_and_timed(capsys):
    pytest.importorskip("torch", reason="needs PyTorch")
    assert main_of_all([*WORDS, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["cells"]
    agreement, depth, deblurring = (
        [row for row in rows if row["what"] == what]
        for what in ("agreement", "depth", "deblurring")
    )
    assert len(agreement) == len(depth) == 5 and len(deblurring) == 1
    assert all(row["equal"] > 0.999 and row["confidence"] < 0.05 for row in agreement)
    assert all(row["health"] < 0.02 for row in agreement)
    assert [row["layers"] > 0.99 for row in agreement if "layers" in row] == [True]
    for row in depth:
        assert row["p50_ms"] > 0 and row["processor_p50_ms"] > 0 and not row["recorded"]
        assert {"to device", "likelihood", "small patches", "decode", "from device"} <= row[
            "stages_ms"
        ].keys()
    assert deblurring[0]["p50_ms"] > 0


def test_tables_have_rows_for_each(capsys):
    pytest.importorskip("torch", reason="needs PyTorch")
    assert main_of_all(WORDS) == 0
    printed = capsys.readouterr().out
    assert printed.count("128x96") == 3 * 5 + 1 and "processor, by PyTorch" in printed
