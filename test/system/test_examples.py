"""Examples: docstrings give what they show, and those of the documents pass strict types."""

import doctest
import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from documented_python import python_examples

PACKAGE = "coded_aperture_ros"
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def modules_with_examples():
    """Return the names of the package's modules whose text has a prompt of Python."""
    root = Path(import_module(PACKAGE).__file__).parents[1]
    paths = sorted((root / PACKAGE).rglob("*.py"))
    found = [path for path in paths if re.search(r"^ *>>> ", path.read_text(), re.MULTILINE)]
    parts = [path.relative_to(root).with_suffix("").parts for path in found]
    return [".".join(part).removesuffix(".__init__") for part in parts]


@pytest.mark.parametrize("name", modules_with_examples())
def test_examples_of_docstrings_give_what_they_show(name):
    report = []
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    for test in doctest.DocTestFinder().find(import_module(name), name):
        runner.run(test, out=report.append)
    assert runner.tries > 0, f"{name}: no docstring has the example"
    assert runner.failures == 0, "".join(report)


def test_there_are_examples():
    assert len(modules_with_examples()) >= 10


def test_examples_of_the_documents_pass_strict_types(checkout, tmp_path):
    """From another folder, as in a project that uses the package: it ships its types."""
    pytest.importorskip("mypy")
    of_pages = [python_examples(checkout / name) for name in ("README.md", "docs/api.rst")]
    # Those of the reference go on where the one before ends.
    examples = [*of_pages[0], "\n".join(of_pages[1])]
    assert examples
    files = [f"example_{number}.py" for number in range(len(examples))]
    for file, example in zip(files, examples, strict=True):
        (tmp_path / file).write_text(example)
    result = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", *files],
        capture_output=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(checkout)},
        text=True,
        timeout=300,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    (tmp_path / "wrong.py").write_text(
        "from coded_aperture_ros import DepthConfig, load_camera\n"
        "load_camera(1.5)\nDepthConfig(no_such_option=1)\n"
    )
    wrong = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "wrong.py"],
        capture_output=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(checkout)},
        text=True,
        timeout=300,
    )
    assert "[arg-type]" in wrong.stdout and "[call-arg]" in wrong.stdout
