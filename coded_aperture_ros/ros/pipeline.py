"""Camera driver, depth and deblurring in one process."""

import functools
from collections.abc import Sequence

from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode
from coded_aperture_ros.ros.deblur_node import DeblurNode
from coded_aperture_ros.ros.depth_node import DepthNode
from coded_aperture_ros.ros.running import run_nodes
from coded_aperture_ros.ros.topics import LocalTopics


def main(args: Sequence[str] | None = None) -> int:
    """Run the three nodes until told to stop; return the exit status.

    A parameter given as `-p camera_file:=...` goes to all of them, `-p depth_node:levels:=...`
    to one.
    """
    local = LocalTopics()
    nodes = (CameraDriverNode, DepthNode, DeblurNode)
    return run_nodes([functools.partial(node, local=local) for node in nodes], args)
