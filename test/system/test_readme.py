"""Commands and Python of the README and of the pages that begin with it run as they are printed."""

import re
import shlex
import subprocess

import pytest

from coded_aperture_ros.cli.main import main

# These take more than a minute; `test_cli_deblur` and `test_blind` run the like.
_NOT_RUN = ("calibrate blind", "view", "deblur --bank bank.npz --depth moving.npy")
_FAILS = {"check --camera camera.yaml --bank bank.npz sharp.png": 1}


def commands_of(text):
    """Return the command lines of our program, and those that edit a file, in indented blocks."""
    joined = text.replace("\\\n", " ")
    return re.findall(r"^    (?:coded_aperture )?((?<=coded_aperture ).*|sed .*)$", joined, re.M)


@pytest.mark.parametrize(
    ("page", "least"),
    [
        ("README.md", 6),
        pytest.param("docs/start.md", 8, marks=pytest.mark.slow),
        pytest.param("docs/commands.md", 19, marks=pytest.mark.slow),
    ],
)
def test_the_commands_of_a_page_run_one_after_the_other(
    checkout, tmp_path, monkeypatch, capsys, page, least
):
    monkeypatch.chdir(tmp_path)
    commands = commands_of((checkout / page).read_text())
    assert len(commands) >= least
    assert commands[0] == "sample"
    for command in commands:
        if command.startswith(_NOT_RUN):
            continue
        if command.startswith("sed "):
            subprocess.run(command, shell=True, check=True)
            continue
        line = re.sub(r"\s+", " ", command)
        status = main(shlex.split(line))
        assert status == _FAILS.get(line, 0), f"{line}: {capsys.readouterr().err}"
        if command == "sample":
            monkeypatch.chdir(tmp_path / "sample")
    if page != "docs/commands.md":
        return
    (example,) = re.findall(r"```python\n(.*?)```", (checkout / page).read_text(), re.DOTALL)
    names = {}
    exec(compile(example, page, "exec"), names)
    assert names["sharp"].shape == names["frame"].shape == (480, 640, 3)
