"""The package builds with colcon, and its programs run from where `ros2 run` looks for them."""

import os
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from waiting import output_of, run_python, scaled

pytestmark = pytest.mark.skipif(
    find_spec("colcon_core") is None or find_spec("colcon_ros") is None,
    reason="needs colcon-core and colcon-ros (extra dev)",
)

PACKAGE = "coded_aperture_ros"
PROGRAMS = {"camera_driver_node", "depth_node", "deblur_node", "pipeline", "coded_aperture"}
SOURCES = (
    "coded_aperture_ros", "config", "launch", "resource", "urdf",
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
    result = run_python("-m", "colcon", "build", *options, cwd=workspace, timeout_s=200)
    assert result.returncode == 0, result.stdout + result.stderr
    return workspace / "install" / PACKAGE


@pytest.fixture(scope="module", params=["copied", "symlinked"])
def installation(request, checkout, tmp_path_factory):
    options = ["--symlink-install"] if request.param == "symlinked" else []
    return build(tmp_path_factory.mktemp(request.param), checkout, *options)


def sourced(installation: Path, *command: str | Path) -> dict[str, Any]:
    """Return the arguments for subprocess: a command in a shell that has sourced the workspace."""
    setup = installation.parent / "local_setup.sh"
    return {
        "args": ["/bin/sh", "-c", f'. "{setup}" && exec "$0" "$@"', *command],
        "env": dict(os.environ, COLCON_CURRENT_PREFIX=str(installation.parent)),
        "text": True,
    }


def run(installation: Path, program: str, *arguments: str, folder: Path):
    """Run an installed program to its end."""
    executable = installation / "lib" / PACKAGE / program
    return subprocess.run(
        **sourced(installation, executable, *arguments),
        cwd=folder,
        capture_output=True,
        check=False,
        timeout=scaled(60),
    )


def test_colcon_finds_out_that_the_tests_are_for_pytest(checkout):
    """Else `colcon test` would run unittest, which finds none of them, and call it good."""
    from colcon_core.package_augmentation.python import extract_dependencies
    from colcon_python_setup_py.package_identification.python_setup_py import get_setup_information

    setup = get_setup_information(checkout / "setup.py")
    names = {requirement.split(">")[0] for requirement in extract_dependencies(setup)["test"]}
    assert names == {"pytest", "pytest-timeout", "hypothesis"}


def test_programs_are_where_ros2_run_looks(installation):
    folder = installation / "lib" / PACKAGE
    assert {path.name for path in folder.iterdir()} == PROGRAMS
    assert all(os.access(path, os.X_OK) for path in folder.iterdir())


def test_shared_files_are_installed(installation, checkout):
    share = installation / "share"
    assert (share / "ament_index/resource_index/packages" / PACKAGE).is_file()
    assert (share / PACKAGE / "package.xml").is_file()
    patterns = {"config": ("*.yaml", "*.xml"), "launch": ("*.py",), "urdf": ("*.xacro",)}
    for folder, pattern in ((name, each) for name in patterns for each in patterns[name]):
        expected = {path.name for path in (checkout / folder).glob(pattern)}
        assert {path.name for path in (share / PACKAGE / folder).glob(pattern)} == expected
        assert expected


def test_the_installed_copy_is_what_runs(installation, tmp_path):
    result = run(installation, "coded_aperture", "--version", folder=tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith("coded_aperture ")
    python = (
        "from coded_aperture_ros.core.share import share_directory; "
        "assert (share_directory() / 'config').is_dir(); print(share_directory())"
    )
    where = subprocess.run(
        **sourced(installation, sys.executable, "-c", python),
        cwd=tmp_path,
        capture_output=True,
        check=True,
        timeout=scaled(60),
    ).stdout.strip()
    assert Path(where).is_relative_to(installation.parent.parent)


def test_a_node_that_lacks_its_bank_ends_with_one_line(installation, checkout, tmp_path):
    pytest.importorskip("rclpy")
    camera = checkout / "config" / "example_camera.yaml"
    result = run(
        installation, "depth_node", "--ros-args",
        "-p", f"camera_file:={camera}", "-p", "bank:=missing.npz", folder=tmp_path,
    )  # fmt: skip
    assert result.returncode == 1
    assert "missing.npz" in result.stderr
    assert len(result.stderr.splitlines()) == 1, result.stderr


def test_a_node_starts_and_ends(installation, checkout, tmp_path):
    rclpy = pytest.importorskip("rclpy")
    picture = tmp_path / "frame.png"
    cv2.imwrite(str(picture), np.zeros((480, 640), np.uint8))
    parameters = {"camera_file": checkout / "config" / "demo_camera.yaml", "source": picture}
    arguments = ["--ros-args", "-r", "__ns:=/installed"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={value}"]
    process = subprocess.Popen(
        **sourced(installation, installation / "lib" / PACKAGE / "camera_driver_node", *arguments),
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("observer", context=context)
    try:
        deadline = time.monotonic() + scaled(60)
        while not node.count_publishers("/installed/image_raw"):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline, "the node did not advertise its images"
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        _, errors = output_of(process)
    finally:
        process.kill()
        process.wait()
        node.destroy_node()
        rclpy.shutdown(context=context)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
