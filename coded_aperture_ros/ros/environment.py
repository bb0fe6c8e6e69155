"""What rclpy needs from the environment when it comes from the wheels on PyPI.

An installed ROS is set up by its `setup.bash`; nothing here changes anything then.
"""

import contextlib
import os
import sys
from importlib.util import find_spec
from pathlib import Path

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.share import shared_memory_profile, shared_memory_suffices

_PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_DDS_VARIABLES = (_PROFILE_VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
_BOOTSTRAP = "ros_wheels_bootstrapper"

# Nodes share a computer. Threads that wait for each other on busy cores cost far more than they
# bring: one frame took 2.4 s instead of 0.12 s beside two busy processes.
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)


def limit_libraries() -> None:
    """Let numerical libraries work in one thread, and OpenCV refuse enormous compressed pictures.

    A message of some bytes could otherwise take gigabytes. What the user has said counts. Call it
    before NumPy and OpenCV are imported: they read the variables then.
    """
    for variable in _THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**26))  # 64 million


def share_large_messages() -> None:
    """Let Fast DDS hand over full-size images in shared memory, unless the user has said otherwise.

    Its default segment is smaller than one image, so that best-effort subscribers on the same
    machine would lose most. Call it before rclpy is imported.
    """
    said = any(os.environ.get(name) for name in _DDS_VARIABLES)
    if said or Path("DEFAULT_FASTRTPS_PROFILES.xml").exists() or not shared_memory_suffices():
        return
    with contextlib.suppress(InputError):  # copied without its shared files
        os.environ[_PROFILE_VARIABLE] = str(shared_memory_profile())


def prepare_ros_environment() -> None:
    """Make `import rclpy` and what follows work with the wheels; call it before the import.

    Raises `SystemExit` with one line that says what to install, where rclpy is not to be found.
    """
    if find_spec("rclpy") is None:
        raise SystemExit(
            "coded_aperture_ros: rclpy not found: source /opt/ros/jazzy/setup.bash, or without "
            "ROS, in the folder of the checkout, pip install '.[ros]'"
        )
    if not _rclpy_is_a_wheel():
        return
    os.environ.setdefault("ROS_DISTRO", "jazzy")
    prefixes = [one for one in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if one]
    if sys.prefix not in prefixes:
        os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join([sys.prefix, *prefixes])


def _rclpy_is_a_wheel() -> bool:
    # A virtual environment may hold the wheels while rclpy comes from a sourced ROS all the same,
    # by PYTHONPATH: what counts is where rclpy will be imported from.
    rclpy, bootstrap = find_spec("rclpy"), find_spec(_BOOTSTRAP)
    if rclpy is None or bootstrap is None or rclpy.origin is None or bootstrap.origin is None:
        return False
    return Path(rclpy.origin).parents[1] == Path(bootstrap.origin).parents[1]
