"""The programs that start nodes; also `python -m coded_aperture_ros.ros.programs NODE ...`.

Importing the nodes takes seconds. Whoever stops a program meanwhile does not want to see a crash,
so that what to do then is said before anything else.
"""

import os
import signal
import sys
from functools import partial
from importlib import import_module
from types import FrameType


def _run(name: str) -> int:
    """Run a program; return the exit status."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _end_at_once)
    status: int = import_module(f"coded_aperture_ros.ros.{name}").main()
    return status


def _end_at_once(number: int, frame: FrameType | None) -> None:
    # Nothing has been started that would have to be ended, and an exception may be swallowed by
    # whatever is being imported.
    os._exit(0)


camera_driver_node = partial(_run, "camera_driver_node")
depth_node = partial(_run, "depth_node")
deblur_node = partial(_run, "deblur_node")
pipeline = partial(_run, "pipeline")
PROGRAMS = {
    "camera_driver_node": camera_driver_node,
    "depth_node": depth_node,
    "deblur_node": deblur_node,
    "pipeline": pipeline,
}


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in PROGRAMS:
        sys.exit(f"usage: python -m coded_aperture_ros.ros.programs {{{','.join(PROGRAMS)}}} ...")
    sys.argv = sys.argv[1:]
    sys.exit(PROGRAMS[sys.argv[0]]())
