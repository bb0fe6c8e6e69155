"""The benchmark beside OpenCV's stereo matching: every way is timed."""

import json

from coded_aperture_benchmarks.__main__ import main_of_all


def test_all_ways_take_turns(capsys):
    words = ["against", "--size", "128x80", "--threads", "1", "--frames", "2", "--json"]
    assert main_of_all(words) == 0
    results = json.loads(capsys.readouterr().out)
    (found,) = results["cells"]
    assert found["threads"] == 1 and found["gflop_s"] > 0
    ways = [row["way"] for row in found["rows"]]
    assert len(ways) == 8 and len(set(ways)) == 8
    assert all(row["ms"] > 0 and row["processor_ms"] > 0 for row in found["rows"])


def test_the_table_has_a_row_for_each(capsys):
    words = ["against", "--size", "128x80", "--threads", "1", "--frames", "1"]
    assert main_of_all(words) == 0
    printed = capsys.readouterr().out
    assert "1 thread(s)" in printed and "64 disparities" in printed
    assert len(printed.splitlines()) == 2 + 8
