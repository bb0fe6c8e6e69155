"""Commands and Python of the README and of the pages that begin with it run as they are printed."""

import re
import shlex
import shutil
import subprocess
import sys

import numpy as np
import pytest
from asymmetric_planes import few_steps
from documented_python import python_examples

from coded_aperture_ros.cli.main import main
from coded_aperture_ros.io import read_depth

# These take more than a minute, and `test_cli_deblur` and `test_blind` run the like; or they need
# pictures of one's own.
_NOT_RUN = (
    "calibrate blind",
    "view",
    "deblur --bank bank.npz --depth moving.npy",
    "calibrate planes planes_hq",
    "check --camera hq.yaml --bank bank.npz",
    "depth --bank bank.npz --gamma 2.2",
)
# Examples of `--help`, which `test_cli_examples` runs.
_GENERATED = "<!-- What follows is generated"
_FAILS = {"check --camera camera.yaml --bank bank.npz sharp.png": 1}


def commands_of(text):
    """Return the command lines of our program, and those that edit a file, in indented blocks."""
    joined = text.replace("\\\n", " ")
    own = r"(?<=coded_aperture ).*|sed .*|python3 -c .*"
    return re.findall(rf"^    (?:coded_aperture )?({own})$", joined, re.M)


def write_described(page, folder):
    """Write the files that a page shows after the words "as `NAME`"."""
    for name, described in re.findall(
        r"as `(\w+\.yaml)`(?:(?!```).)*?^```yaml\n(.*?)^```", page, re.M | re.S
    ):
        (folder / name).write_text(described)


def assert_printed(page, printed):
    """Check that what a page shows of the output was printed, in order; numbers to a tenth."""
    number = r"\d+(?:\.\d+)?"
    lines = [" ".join(line.split()) for line in printed]
    blocks = re.findall(r"^```text\n(.*?)^```", page, re.M | re.S)
    for line in "".join(blocks).splitlines():
        shown = " ".join(line.split())
        pattern = f"({number})".join(map(re.escape, re.split(number, shown)))
        while lines and not re.search(pattern, lines[0]):
            del lines[0]
        assert lines, f"not printed: {shown}"
        found = map(float, re.search(pattern, lines[0]).groups())
        expected = [float(one) for one in re.findall(number, shown)]
        assert list(found) == pytest.approx(expected, rel=0.1, abs=0.011), shown


@pytest.fixture(scope="module")
def first_sample():
    """What the first `sample` of all pages has made and printed: the others copy it."""
    return {}


@pytest.mark.parametrize(
    ("page", "least"),
    [
        pytest.param("docs/start.md", 11, marks=pytest.mark.slow),
        pytest.param("docs/commands.md", 19, marks=pytest.mark.slow),
        pytest.param("docs/build.md", 17, marks=pytest.mark.slow),
        pytest.param("docs/will_it_work.md", 2, marks=pytest.mark.slow),
    ],
)
def test_the_commands_of_a_page_run_one_after_the_other(
    checkout, tmp_path, tmp_path_factory, first_sample, monkeypatch, capsys, caplog, page, least
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config").symlink_to(checkout / "config")
    text = (checkout / page).read_text().partition(_GENERATED)[0]
    commands = commands_of(text)
    printed = []
    assert len(commands) >= least
    assert commands[0] == "sample" or page == "docs/will_it_work.md"
    write_described(text, tmp_path)
    for command in commands:
        if command.startswith(_NOT_RUN):
            continue
        if command.startswith(("sed ", "python3 ")):
            command = command.replace("python3", sys.executable, 1)
            subprocess.run(command, shell=True, check=True)
            continue
        if command == "sample" and first_sample:
            shutil.copytree(first_sample["folder"], "sample")
            said = first_sample["said"]
        else:
            line = re.sub(r"\s+", " ", command)
            with monkeypatch.context() as patched:
                if line.startswith("learn --planes"):  # `calibrate planes`, next, fits to the end
                    few_steps(patched)
                status = main(shlex.split(line))
            assert status == _FAILS.get(line, 0), f"{line}: {capsys.readouterr().err}"
            said = [*caplog.messages, *capsys.readouterr().out.splitlines()]
            caplog.clear()
        printed += said
        if command == "sample":
            if not first_sample:
                folder = tmp_path_factory.mktemp("first") / "sample"
                first_sample.update(folder=shutil.copytree("sample", folder), said=said)
            monkeypatch.chdir(tmp_path / "sample")
            write_described(text, tmp_path / "sample")
    assert_printed(text, printed)


@pytest.mark.slow
def test_the_examples_of_the_reference_run_one_after_the_other(checkout, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["sample"]) == 0
    monkeypatch.chdir(tmp_path / "sample")
    names = {}
    for example in python_examples(checkout / "docs" / "api.rst"):
        exec(compile(example, "docs/api.rst", "exec"), names)
    assert names["sharp"].shape == names["frame"].shape == (480, 640, 3)
    assert np.median(names["error"]) < 0.02
    assert names["by_patch"].estimate(names["frame"]).depth_m.shape == (480, 640)


def test_the_readme_fits_one_screen_of_reading(checkout):
    text = (checkout / "README.md").read_text()
    assert len(text.split()) <= 500
    blocks = re.findall(r"^```.*?\n(.*?)^```", text, re.M | re.S)
    lines = [*"".join(blocks).splitlines(), *re.findall(r"^    \S.*", text, re.M)]
    assert len(lines) <= 15


def test_the_python_of_the_readme_runs(checkout, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["sample"]) == 0
    (example,) = re.findall(r"```python\n(.*?)```", (checkout / "README.md").read_text(), re.DOTALL)
    names = {}
    exec(compile(example, "README.md", "exec"), names)
    truth_m = read_depth("sample/depth.png")
    depth_m = names["estimate"].depth_m
    known = np.isfinite(depth_m) & (truth_m > 0)
    assert np.median(np.abs(depth_m / truth_m - 1)[known]) < 0.02
