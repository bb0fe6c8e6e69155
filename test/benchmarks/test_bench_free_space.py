"""`python -m coded_aperture_benchmarks free-space`: a few frames, and what is counted."""

import pytest
from cli_scene import json_of_benchmarks
from coded_aperture_benchmarks.suites import free_space

pytest.importorskip("numba", reason="random scenes need numba")


@pytest.mark.slow
def test_a_few_random_frames(capsys, tmp_path):
    pytest.importorskip("matplotlib")
    arguments = ("free-space", "--frames", 1, "--risks", 0.01, 0.001, "--jobs", 1)
    results = json_of_benchmarks(capsys, *arguments, "--output", tmp_path)
    assert [(row["of"], row["risk"]) for row in results["by_kind"]] == [
        (kind, risk) for kind in free_space.KINDS for risk in (0.01, 0.001)
    ]
    for row in results["rows"]:
        assert row["fits"] and row["nearer"] < 0.05
    more, less = results["all"]
    assert less["gain"] < more["gain"] < 1 and less["of_truth"] <= more["of_truth"] < 1
    assert (tmp_path / "room_levin.jpg").is_file()
    text = free_space.SUITE.text(results)
    assert "3 of 3 frames fit their bank" in text and "0.1 %" in text
