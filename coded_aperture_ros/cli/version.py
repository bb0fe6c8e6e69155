"""`coded_aperture --version`: the program's version, and what a report of a fault should name."""

import os
import platform
from importlib import import_module

from coded_aperture_ros import __version__
from coded_aperture_ros.core.blas import slow_blas_warning
from coded_aperture_ros.core.workers import processors

_LIBRARIES = "numpy", "scipy", "cv2", "numba", "rclpy", "torch", "onnxruntime"


def print_version(program: str) -> None:
    """Print the program's version and its surroundings."""
    print("\n".join([f"{program} {__version__}", *surroundings()]))


def surroundings() -> list[str]:
    """Return one line about the machine, one about libraries, and one about ROS."""
    libraries = ", ".join(f"{name} {_version(name)}" for name in _LIBRARIES)
    rmw = os.environ.get("RMW_IMPLEMENTATION", "default")
    return [
        f"Python {platform.python_version()}, {platform.platform()}, {processors()} processors",
        f"{libraries}; {'reference BLAS, slow' if slow_blas_warning() else 'BLAS as it should be'}",
        f"ROS {os.environ.get('ROS_DISTRO', 'not sourced')}, middleware: {rmw}",
    ]


def _version(name: str) -> str:
    try:
        return str(getattr(import_module(name), "__version__", "installed"))
    except Exception:  # what is broken must not hide the rest
        return "missing"
