"""Examples of the gallery run as scripts, away from the checkout, and their own checks hold."""

import ast
import importlib
import json
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


@pytest.fixture
def maker(checkout, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(checkout) / "scripts"))
    yield importlib.import_module("make_notebooks")
    sys.modules.pop("make_notebooks")


def test_notebooks_are_up_to_date(maker):
    wanted = maker.notebooks()
    assert {path: path.read_text() for path in maker.NOTEBOOKS.iterdir()} == wanted
    assert len(wanted) == len(EXAMPLES) == 8


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_a_notebook_has_the_code_of_its_example(maker, example):
    """But for the first cell, which installs the package."""
    notebook = json.loads((maker.NOTEBOOKS / f"{example.stem}.ipynb").read_text())
    first, *cells = (
        "".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"
    )
    assert "%pip install" in first and maker.repository() in first
    code = ast.parse(example.read_text())
    del code.body[0]  # the title
    assert ast.dump(ast.parse("\n".join(cells))) == ast.dump(code)
