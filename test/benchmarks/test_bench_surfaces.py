"""Two surfaces, and two focus settings: a few frames, and what is counted."""

import pytest
from cli_scene import json_of_benchmarks
from coded_aperture_benchmarks.suites import focus, second

pytest.importorskip("numba", reason="random scenes need numba")


@pytest.mark.slow
def test_a_few_fences(capsys, tmp_path):
    pytest.importorskip("matplotlib")
    arguments = ("second", "--frames", 1, "--jobs", 1, "--output", tmp_path)
    results = json_of_benchmarks(capsys, *arguments)
    by_kind = {row["of"]: row for row in results["by_kind"]}
    assert tuple(by_kind) == second.KINDS
    plain = by_kind[second.PLAIN]
    assert plain["windows_of_two"] == 0 and plain["found"] is None and plain["false"] < 0.1
    leaves = by_kind["leaves"]
    assert leaves["found"] > 0.5 and leaves["both_right"] <= leaves["found"]
    assert (tmp_path / "leaves_levin.jpg").is_file()
    assert "taken for two" in second.SUITE.text(results)


@pytest.mark.slow
def test_a_few_pairs(capsys, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(focus, "_SIZE", (192, 256))
    arguments = ("focus", "--scenes", 1, "--masks", "levin", "--jobs", 1, "--output", tmp_path)
    results = json_of_benchmarks(capsys, *arguments)
    pooled = {(row["setting"], row["given"]): row for row in results["pooled"]}
    assert len(pooled) == 3 * len(focus.SETTINGS)
    for setting in ("within", "both within"):
        assert pooled[setting, "both"]["right"] > pooled[setting, "first"]["right"]
    assert (tmp_path / "both_within_levin.jpg").is_file()
    assert "twice the exposure" in focus.SUITE.text(results)
