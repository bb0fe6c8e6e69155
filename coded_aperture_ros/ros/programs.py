"""The programs that start nodes; also `python -m coded_aperture_ros.ros.programs NODE ...`.

Importing the nodes takes seconds. Signals are handled before that, so that stopping a program
meanwhile does not look like a crash.
"""

import os
import signal
import sys
from functools import partial
from importlib import import_module

NODES = {
    "camera_driver_node": "CameraDriverNode",
    "depth_node": "DepthNode",
    "deblur_node": "DeblurNode",
}


_HELP = """usage: ros2 run coded_aperture_ros {name} --ros-args -p PARAMETER:=VALUE ...

{what}

{needed}. Example:
  ros2 run coded_aperture_ros {name} --ros-args -p camera_file:=/path/to/camera.yaml{example}

All parameters, with defaults and ranges, while it runs: ros2 param describe /{name} NAME; the most
useful ones are in docs/robot.md. Without the program ros2, {name} takes the same arguments.
"""
_WHAT = {
    "camera_driver_node": "Publishes frames of a device, files, a bag or a simulator (source).",
    "depth_node": "Publishes metric depth of coded frames, and its confidence.",
    "deblur_node": "Publishes all-in-focus pictures, from coded frames and their depth.",
}


def _help(names: tuple[str, ...]) -> str:
    name = names[0] if len(names) == 1 else "pipeline"
    what = "\n".join(_WHAT[one] for one in names)
    measures = name != "camera_driver_node"
    needed = "Needed: camera_file, a camera file (YAML)"
    needed += ", and near_m and far_m or a bank" if measures else ", but for the simulator"
    example = " -p near_m:=0.8 -p far_m:=3.0" if measures else " -p source:=/dev/video0"
    return _HELP.format(name=name, what=what, needed=needed, example=example)


def _run(*names: str) -> int:
    """Run nodes in this process until SIGINT or SIGTERM; return the exit status.

    A parameter given as `-p camera_file:=...` goes to all nodes, `-p depth_node:lazy:=...` to one.
    """
    if {"-h", "--help"} & set(sys.argv[1:]):
        sys.stdout.write(_help(names))
        return 0
    for number in (signal.SIGINT, signal.SIGTERM):
        # Nothing has to be cleaned up yet, and an import might swallow an exception.
        signal.signal(number, lambda *_: os._exit(0))
    from coded_aperture_ros.ros.environment import keep_freed_memory, share_large_messages

    keep_freed_memory()
    share_large_messages()
    from coded_aperture_ros.ros.running import run_nodes
    from coded_aperture_ros.ros.topics import LocalTopics

    modules = {name: import_module(f"coded_aperture_ros.ros.{name}") for name in names}
    local = LocalTopics() if len(names) > 1 else None
    return run_nodes([partial(getattr(modules[name], NODES[name]), local=local) for name in names])


camera_driver_node = partial(_run, "camera_driver_node")
depth_node = partial(_run, "depth_node")
deblur_node = partial(_run, "deblur_node")
pipeline = partial(_run, *NODES)
PROGRAMS = {name: partial(_run, name) for name in NODES} | {"pipeline": pipeline}


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in PROGRAMS:
        sys.exit(f"usage: python -m coded_aperture_ros.ros.programs {{{','.join(PROGRAMS)}}} ...")
    sys.argv = sys.argv[1:]
    sys.exit(PROGRAMS[sys.argv[0]]())
