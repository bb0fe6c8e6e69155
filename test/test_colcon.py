"""The package builds with colcon, and its programs run from where `ros2 run` looks for them."""

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(
    find_spec("colcon_core") is None or find_spec("colcon_ros") is None,
    reason="needs colcon-core and colcon-ros (extra dev)",
)

PACKAGE = "coded_aperture_ros"
PROGRAMS = {"camera_driver_node", "depth_node", "deblur_node", "pipeline", "coded_aperture"}
SOURCES = (
    "coded_aperture_ros", "config", "launch", "resource",
    "LICENSE", "README.md", "package.xml", "pyproject.toml", "setup.cfg", "setup.py",
)  # fmt: skip


def build(workspace: Path, checkout: Path, *options: str) -> Path:
    """Build a copy of the package and return its installation folder."""
    copy = workspace / "src" / PACKAGE
    copy.mkdir(parents=True)
    for name in SOURCES:
        source = checkout / name
        if source.is_dir():
            shutil.copytree(source, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        elif source.exists():
            shutil.copy(source, copy / name)
    result = subprocess.run(
        [sys.executable, "-m", "colcon", "build", *options],
        cwd=workspace,
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return workspace / "install" / PACKAGE


@pytest.fixture(scope="module", params=["copied", "symlinked"])
def installation(request, checkout, tmp_path_factory):
    options = ["--symlink-install"] if request.param == "symlinked" else []
    return build(tmp_path_factory.mktemp(request.param), checkout, *options)


def run(installation: Path, program: str, *arguments: str, folder: Path):
    """Run an installed program in a shell that has sourced the workspace."""
    setup = installation.parent / "local_setup.sh"
    executable = installation / "lib" / PACKAGE / program
    environment = dict(os.environ, COLCON_CURRENT_PREFIX=str(installation.parent))
    return subprocess.run(
        ["/bin/sh", "-c", f'. "{setup}" && exec "$0" "$@"', executable, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def test_programs_are_where_ros2_run_looks(installation):
    folder = installation / "lib" / PACKAGE
    assert {path.name for path in folder.iterdir()} == PROGRAMS
    assert all(os.access(path, os.X_OK) for path in folder.iterdir())


def test_shared_files_are_installed(installation, checkout):
    share = installation / "share"
    assert (share / "ament_index/resource_index/packages" / PACKAGE).is_file()
    assert (share / PACKAGE / "package.xml").is_file()
    for folder, pattern in (("config", "*.yaml"), ("config", "*.xml"), ("launch", "*.py")):
        expected = {path.name for path in (checkout / folder).glob(pattern)}
        assert {path.name for path in (share / PACKAGE / folder).glob(pattern)} == expected
        assert expected


def test_the_installed_copy_is_what_runs(installation, tmp_path):
    result = run(installation, "coded_aperture", "--version", folder=tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith("coded_aperture ")
    python = (
        "from coded_aperture_ros.share import share_directory; "
        "assert (share_directory() / 'config').is_dir(); print(share_directory())"
    )
    setup = installation.parent / "local_setup.sh"
    where = subprocess.run(
        ["/bin/sh", "-c", f'. "{setup}" && exec "$0" -c "$1"', sys.executable, python],
        cwd=tmp_path,
        env=dict(os.environ, COLCON_CURRENT_PREFIX=str(installation.parent)),
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    ).stdout.strip()
    assert Path(where).is_relative_to(installation.parent.parent)


def test_a_node_that_lacks_its_bank_ends_with_one_line(installation, checkout, tmp_path):
    pytest.importorskip("rclpy")
    camera = next((checkout / "config").glob("*camera*.yaml"))
    result = run(
        installation, "depth_node", "--ros-args",
        "-p", f"camera_file:={camera}", "-p", "bank:=missing.npz", folder=tmp_path,
    )  # fmt: skip
    assert result.returncode == 1
    assert "missing.npz" in result.stderr
    assert len(result.stderr.splitlines()) == 1, result.stderr
