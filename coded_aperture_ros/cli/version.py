"""`coded_aperture --version`: the program's version, and what a report of a fault should name."""

import argparse
import os
import platform
from importlib import import_module
from typing import Any

from coded_aperture_ros import __version__
from coded_aperture_ros.core.blas import slow_blas_warning
from coded_aperture_ros.core.workers import processors

_LIBRARIES = "numpy", "scipy", "cv2", "numba", "rclpy", "torch", "onnxruntime"


class ShowVersion(argparse.Action):
    """Print the program's version and its surroundings, and end."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> None:
        """Do what the option asks for."""
        print("\n".join([f"{parser.prog} {__version__}", *surroundings()]))
        parser.exit()


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
