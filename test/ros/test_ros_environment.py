"""The environment variables that the wheels of rclpy need and an installed ROS must keep."""

import os
import platform
import sys
import types
from pathlib import Path

import pytest
from waiting import run_python

pytest.importorskip("rclpy")

from clean_environment import clean_environment

from coded_aperture_ros.ros import environment


@pytest.fixture
def found(monkeypatch):
    """Choose where modules are found; those not named are missing."""

    def choose(**origins):
        monkeypatch.setattr(
            environment,
            "find_spec",
            lambda name: types.SimpleNamespace(origin=origins[name]) if name in origins else None,
        )

    return choose


WHEELS = {
    "rclpy": f"{sys.prefix}/lib/python3/site-packages/rclpy/__init__.py",
    "ros_wheels_bootstrapper": (
        f"{sys.prefix}/lib/python3/site-packages/ros_wheels_bootstrapper/__init__.py"
    ),
}
INSTALLED = {"rclpy": "/opt/ros/jazzy/lib/python3.12/site-packages/rclpy/__init__.py"}


def test_wheels_get_their_prefix_and_a_distribution(found, monkeypatch):
    found(**WHEELS)
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    environment.prepare_ros_environment()
    environment.prepare_ros_environment()
    assert os.environ["AMENT_PREFIX_PATH"] == sys.prefix
    assert os.environ["ROS_DISTRO"] == "jazzy"


def test_wheels_keep_the_workspaces_of_the_user(found, monkeypatch):
    found(**WHEELS)
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/home/user/ws/install/mine")
    monkeypatch.setenv("ROS_DISTRO", "rolling")
    environment.prepare_ros_environment()
    assert os.environ["AMENT_PREFIX_PATH"] == f"{sys.prefix}:/home/user/ws/install/mine"
    assert os.environ["ROS_DISTRO"] == "rolling"


@pytest.mark.parametrize("beside", [{}, {"ros_wheels_bootstrapper": WHEELS["rclpy"]}])
def test_an_installed_ros_is_left_alone(found, monkeypatch, beside):
    """Even where the wheels lie unused in the same environment."""
    found(**INSTALLED, **beside)
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/ros/jazzy")
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    before = dict(os.environ)
    environment.prepare_ros_environment()
    assert dict(os.environ) == before


def test_without_rclpy_programs_say_what_to_install(tmp_path):
    """In a Python that has no rclpy, a node ends with one line and status 1."""
    code = (
        "import sys, importlib.util as util\n"
        "find = util.find_spec\n"
        "util.find_spec = lambda name, *rest: None if name == 'rclpy' else find(name, *rest)\n"
        "import coded_aperture_ros.ros\n"
    )
    result = run_python("-c", code)
    assert result.returncode == 1
    assert len(result.stderr.splitlines()) == 1
    assert "pip install" in result.stderr
    assert "setup.bash" in result.stderr


def test_the_environment_for_another_python(monkeypatch):
    libraries = Path(sys.prefix).resolve() / "lib/python3/site-packages/ros_rcl.libs"
    monkeypatch.setenv("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "1")
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{sys.prefix}/lib:{libraries}:/opt/mine/lib")
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    clean = clean_environment()
    assert "_ROS_WHEELS_BOOTSTRAP_COMPLETE" not in clean
    assert clean["LD_LIBRARY_PATH"] == "/opt/mine/lib"
    assert "AMENT_PREFIX_PATH" not in clean
    assert clean["ROS_DOMAIN_ID"] == "7"
    assert os.environ["LD_LIBRARY_PATH"] != clean["LD_LIBRARY_PATH"]


def test_an_installed_ros_keeps_its_library_path(monkeypatch):
    monkeypatch.delenv("_ROS_WHEELS_BOOTSTRAP_COMPLETE", raising=False)
    path = f"/opt/ros/jazzy/lib:{sys.prefix}/lib"
    monkeypatch.setenv("LD_LIBRARY_PATH", path)
    assert clean_environment()["LD_LIBRARY_PATH"] == path


def test_the_wheels_start_with_the_clean_environment():
    """The other Python is this one here: its wheels must set themselves up again."""
    code = "import coded_aperture_ros.ros, rclpy; rclpy.init(); rclpy.shutdown(); print('works')"
    result = run_python("-c", code, env=clean_environment())
    assert (result.stdout, result.returncode) == ("works\n", 0), result.stderr


@pytest.mark.parametrize("room", [True, False])
def test_nodes_share_large_messages_where_there_is_room(monkeypatch, room):
    for name in environment._DDS_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(environment, "shared_memory_suffices", lambda: room)
    environment.share_large_messages()
    profile = os.environ.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)
    assert (profile is not None) == room
    if room:
        assert Path(profile).name == "fastdds_shared_memory.xml" and Path(profile).is_file()


@pytest.mark.parametrize("name", environment._DDS_VARIABLES)
def test_settings_of_the_user_for_dds_stay(monkeypatch, name):
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    monkeypatch.setenv(name, "mine")
    monkeypatch.setattr(environment, "shared_memory_suffices", lambda: True)
    environment.share_large_messages()
    assert os.environ[name] == "mine"
    assert os.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE") in (None, "mine")


MEMORY = """
import resource, threading
from coded_aperture_ros.ros.environment import keep_freed_memory
keep_freed_memory()
import numpy as np

def frames(count):
    for _ in range(count):
        maps = [np.ones((720, 1280), np.float32) for _ in range(4)]
        del maps

def faults(count):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    thread = threading.Thread(target=frames, args=(count,))
    thread.start()
    thread.join()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

faults(5)
print(faults(20))
"""


# Four maps of 1280x720 in 32 bits, twenty times, in pages of 4 KiB.
PAGES_OF_FRAMES = 20 * 4 * 720 * 1280 * 4 / 4096


def page_faults_of_frames(**variables):
    """Those of frames of `MEMORY`, where only these variables are glibc's."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("MALLOC_") and name != "GLIBC_TUNABLES"
    }
    done = run_python("-c", MEMORY, env=kept | variables)
    assert done.returncode == 0, done.stderr
    return int(done.stdout)


def test_memory_of_a_frame_is_kept_for_the_next():
    if platform.libc_ver()[0] == "glibc":
        assert page_faults_of_frames() < PAGES_OF_FRAMES / 10


@pytest.mark.parametrize(
    "chosen",
    [
        {"MALLOC_TRIM_THRESHOLD_": "100000"},
        {"GLIBC_TUNABLES": "glibc.malloc.trim_threshold=100000"},
    ],
)
def test_settings_of_the_user_for_memory_stay(chosen):
    if platform.libc_ver()[0] == "glibc":
        assert page_faults_of_frames(**chosen) > PAGES_OF_FRAMES / 2
