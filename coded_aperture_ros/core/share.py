"""Where the package's camera files, profiles and parameter files are."""

import os
from pathlib import Path

from coded_aperture_ros.core.errors import InputError

_PACKAGE = "coded_aperture_ros"
# Four processes with a segment of 64 MiB each.
SHARED_MEMORY_MB = 280


def share_directory() -> Path:
    """Return the folder that has the `config` folder of this package in it.

    That is `PREFIX/share/coded_aperture_ros` where the package is installed (by pip, colcon or a
    system package), and the source checkout where it runs from there. No ROS is needed. Raises
    `InputError` if the package was copied without its shared files.
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


def shared_memory_profile() -> Path:
    """Return the settings with which Fast DDS hands large messages over in shared memory."""
    return share_directory() / "config" / "fastdds_shared_memory.xml"


def shared_memory_suffices(folder: str = "/dev/shm") -> bool:
    """Return whether there is room for the segments; containers often have 64 MB only."""
    try:
        status = os.statvfs(folder)
    except OSError:
        return False
    return status.f_bavail * status.f_frsize >= SHARED_MEMORY_MB * 2**20


def private_network(shared_memory: bool) -> dict[str, str]:
    """Return the environment that keeps the topics of our processes apart from any robot's."""
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
