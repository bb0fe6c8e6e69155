"""Environment variables of a node: threads of libraries, DDS, and rclpy from wheels.

With an installed ROS, whose `setup.bash` sets it up, the variables of rclpy stay as they are.
"""

import contextlib
import ctypes
import os
import sys
from importlib.util import find_spec
from pathlib import Path

from coded_aperture_ros.core.blas import set_blas_variables
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.share import shared_memory_profile, shared_memory_suffices

_PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_DDS_VARIABLES = (_PROFILE_VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
# Names in malloc.h: M_ARENA_MAX, M_MMAP_THRESHOLD (bytes, the largest), M_TRIM_THRESHOLD (bytes).
_MALLOC_OPTIONS = ((-8, 1), (-3, 32 * 2**20), (-1, 256 * 2**20))
_BOOTSTRAP = "ros_wheels_bootstrapper"

# Nodes share a computer. Threads of libraries that wait for each other on busy cores slow a frame
# down: it took 2.4 s instead of 0.12 s beside two busy processes.
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")


def limit_libraries() -> None:
    """Set one thread for numerical libraries, and OpenCV's limit for compressed pictures.

    Without the limit a message of some bytes could take gigabytes. Variables that are set already
    stay. Call it before NumPy and OpenCV are imported: they read the variables then.
    """
    set_blas_variables()
    for variable in _THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**26))  # 64 million


def share_large_messages() -> None:
    """Let Fast DDS transfer full-size images in shared memory, unless DDS is configured already.

    Its default segment is smaller than one image, so that best-effort subscribers on the same
    machine would lose most. Call it before rclpy is imported.
    """
    configured = any(os.environ.get(name) for name in _DDS_VARIABLES)
    if configured or Path("DEFAULT_FASTRTPS_PROFILES.xml").exists() or not shared_memory_suffices():
        return
    with contextlib.suppress(InputError):  # the package was copied without its shared files
        os.environ[_PROFILE_VARIABLE] = str(shared_memory_profile())


def keep_freed_memory() -> None:
    """Let glibc keep what a frame has freed for the next one, unless its variables are set.

    By default it may return memory to the system after every frame and ask for it again: for the
    transport of 1280x720 alone that took 2700 page faults a frame, 5 ms of one core. With one arena
    for all threads `depth_node` takes less memory, too: 510 in place of 593 MB. Call it before
    threads are started.
    """
    chosen = any(name.startswith("MALLOC_") for name in os.environ)
    if chosen or "malloc" in os.environ.get("GLIBC_TUNABLES", ""):
        return
    with contextlib.suppress(AttributeError, OSError):  # another C library
        mallopt = ctypes.CDLL(None).mallopt
        for option, value in _MALLOC_OPTIONS:
            mallopt(option, value)


def prepare_ros_environment() -> None:
    """Set the variables that rclpy from wheels needs; call it before rclpy is imported.

    Raises
    ------
    SystemExit
        If rclpy is not found, with one line that says what to install.
    """
    if find_spec("rclpy") is None:
        raise SystemExit(
            "coded_aperture_ros: rclpy not found: source /opt/ros/jazzy/setup.bash, or without "
            "ROS, in the folder of the checkout, pip install '.[ros]'"
        )
    if not _rclpy_is_a_wheel():
        return
    os.environ.setdefault("ROS_DISTRO", "jazzy")
    prefixes = [path for path in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if path]
    if sys.prefix not in prefixes:
        os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join([sys.prefix, *prefixes])


def _rclpy_is_a_wheel() -> bool:
    # A virtual environment may hold the wheels while PYTHONPATH of a sourced ROS goes first: what
    # counts is where rclpy will be imported from.
    rclpy = find_spec("rclpy")
    bootstrap = find_spec(_BOOTSTRAP)
    if rclpy is None or bootstrap is None or rclpy.origin is None or bootstrap.origin is None:
        return False
    return Path(rclpy.origin).parents[1] == Path(bootstrap.origin).parents[1]
