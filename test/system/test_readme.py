"""The README's Python example and commands run as they are printed."""

import re
import shlex
import shutil

import numpy as np
import pytest
from asymmetric_planes import few_steps, folder_of

from coded_aperture_ros.cli.main import main
from coded_aperture_ros.io import write_depth, write_image


@pytest.fixture(scope="module")
def folder(checkout, tmp_path_factory):
    """What a reader has at hand: a sharp picture, its depth, and the shipped camera file."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "config").mkdir()
    for copy in ("camera.yaml", "config/demo_camera.yaml"):
        shutil.copy(checkout / "config" / "demo_camera.yaml", folder / copy)
    random = np.random.default_rng(0)
    write_image(folder / "sharp.png", random.random((480, 640, 3), dtype=np.float32))
    write_depth(folder / "depth.png", np.full((480, 640), 3.0, np.float32))
    (folder / "planes").mkdir()
    folder_of(folder / "planes")
    return folder


def test_commands_and_python_example(checkout, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    few_steps(monkeypatch)
    readme = (checkout / "README.md").read_text()
    section = readme.split("## From the command line")[1].split("\n## ")[0]
    commands = re.findall(r"^    coded_aperture (.*)$", section, re.MULTILINE)
    assert len(commands) == 9
    for command in commands:
        assert main(shlex.split(command)) == 0, capsys.readouterr().err
    (example,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    names = {}
    exec(compile(example, "README.md", "exec"), names)
    assert names["sharp"].shape == names["frame"].shape == (480, 640, 3)
