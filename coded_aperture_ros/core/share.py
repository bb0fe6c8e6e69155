"""Shared files of the package (camera files, profiles), and the environment that DDS needs."""

import os
from pathlib import Path

from coded_aperture_ros.core.errors import InputError

_PACKAGE = "coded_aperture_ros"
# Room for the segments of four processes, 64 MiB each, MiB.
SHARED_MEMORY_MB = 280


def share_directory() -> Path:
    """Folder that contains the `config` folder of this package; needs no ROS.

    It is `PREFIX/share/coded_aperture_ros` if the package is installed (by pip, colcon or a system
    package), or else the source checkout.

    Raises
    ------
    InputError
        If the package was copied without its shared files.

    Examples
    --------
    >>> (share_directory() / "config").is_dir()
    True
    """
    here = Path(__file__).resolve()
    for parent in here.parents:
        if (parent / "package.xml").is_file() and (parent / "config").is_dir():
            return parent
        installed = parent / "share" / _PACKAGE
        if (installed / "config").is_dir():
            return installed
    raise InputError(
        f"no share/{_PACKAGE}/config above {here.parent}: install the package with pip or colcon"
    )


def demo_camera_file() -> Path:
    """Path of the camera file of demo and sample.

    Examples
    --------
    >>> demo_camera_file().is_file()
    True
    """
    return share_directory() / "config" / "demo_camera.yaml"


def shared_memory_profile() -> Path:
    """Path of the settings with which Fast DDS transfers large messages in shared memory."""
    return share_directory() / "config" / "fastdds_shared_memory.xml"


def shared_memory_suffices(folder: str = "/dev/shm") -> bool:
    """Whether there is room for the segments; containers often have 64 MB only."""
    try:
        status = os.statvfs(folder)
    except OSError:
        return False
    return status.f_bavail * status.f_frsize >= SHARED_MEMORY_MB * 2**20


def private_network(shared_memory: bool) -> dict[str, str]:
    """Environment that keeps the topics of new processes apart from those of any robot.

    Variables that would override it are removed from the environment of this process.
    """
    for name in ("ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "ROS_NAMESPACE", "ROS_DISCOVERY_SERVER"):
        os.environ.pop(name, None)
    environment = {
        # 1 to 100 keep clear of the ports that Linux hands out by itself; 0 is the default.
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    if shared_memory:
        environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(shared_memory_profile())
    return environment
