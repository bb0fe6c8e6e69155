"""Examples of the gallery run as scripts, away from the checkout, and their own checks hold."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import scaled

pytest.importorskip("matplotlib")
EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("plot_*.py"))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_its_checks_hold(checkout, tmp_path, example):
    environment = {**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(checkout)}
    done = subprocess.run(
        [sys.executable, str(example)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=scaled(60),
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout  # what it found


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_checks_what_it_shows(example):
    text = example.read_text()
    assert len(text.splitlines()) <= 60
    assert "\nassert " in text
    assert "plt." in text
