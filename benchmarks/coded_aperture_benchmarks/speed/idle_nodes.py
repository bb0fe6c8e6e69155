"""Programs that answer frames with a constant depth map: what is left is transport.

`python -m coded_aperture_benchmarks.speed.idle_nodes WAY CAMERA_FILE [FRAMES RATE_HZ LOG]`

`null` is a node of rclpy alone, with as little Python as there can be; `depth_node` is the node of
this package with its pipeline replaced. With frames, they are published in the same process: to
`null` over DDS, as rclpy has nothing else, to `depth_node` as in the program `pipeline`.
"""

import contextlib
import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from coded_aperture_benchmarks.speed.frame_publisher import frame_sender, publish_until_stopped
from coded_aperture_benchmarks.speed.node_processes import TOPIC, ros_node
from coded_aperture_ros.core.arrays import Shape
from coded_aperture_ros.depth import DepthEstimate

_MODULE = "coded_aperture_benchmarks.speed.idle_nodes"
WAYS = ("null", "depth_node")
_DEPTH_M = 1.0
# The depth node learns a bank for its camera file, which no frame is compared with.
_PARAMETERS = ("near_m:=0.8", "far_m:=1.4", "learn.level_count:=5")


def arguments(way: str, camera_file: Path, *source: Any) -> list[str]:
    """Return the command line of this program, after the Python interpreter.

    `source` is nothing, or frames, rate and log as `frame_publisher.arguments` takes them.
    """
    return ["-m", _MODULE, way, str(camera_file), *map(str, source)]


def run_null(camera_file: Path, source: list[str]) -> None:
    """Run a bare node until SIGINT or SIGTERM."""
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import Image

    from coded_aperture_ros.ros.messages import image_from_array
    from coded_aperture_ros.ros.running import ExecutorThread

    stopping: list[int] = []
    stopped = threading.Event()

    def stop(number: int, _: Any) -> None:
        stopping.append(number)
        stopped.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    with ros_node("null_node") as (node, context):
        publisher = node.create_publisher(Image, TOPIC, QoSProfile(depth=5))
        answers: dict[Shape, Image] = {}

        def answer(frame: Image) -> None:
            size = frame.height, frame.width
            if size not in answers:
                depth_m = np.full(size, _DEPTH_M, np.float32)
                answers[size] = image_from_array(depth_m, "32FC1", frame.header)
            answers[size].header = frame.header
            publisher.publish(answers[size])

        qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(Image, "image_raw", answer, qos)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        thread = ExecutorThread(executor, "executor", stopped)
        with _frames(node, camera_file, source, stopping):
            stopped.wait()
        thread.stop()


def run_depth_node(camera_file: Path, source: list[str]) -> int:
    """Run the depth node without its pipeline until SIGINT or SIGTERM; return the status."""
    from rclpy.node import Node

    from coded_aperture_ros.ros.environment import keep_freed_memory

    keep_freed_memory()  # as the program of the node does
    from coded_aperture_ros.ros.depth_node import DepthNode
    from coded_aperture_ros.ros.running import run_nodes
    from coded_aperture_ros.ros.topics import LocalTopics

    class IdleDepthNode(DepthNode):
        """Depth node whose pipeline returns a constant map."""

        _idle = IdlePipeline()

        def _present_pipeline(self) -> Any:
            return self._idle

    class FrameNode(Node):
        """Node that publishes frames from a thread of its own."""

        def __init__(self) -> None:
            super().__init__("frame_publisher")
            self._stopping: list[int] = []
            self._frames = contextlib.ExitStack()
            self._frames.enter_context(_frames(self, camera_file, source, self._stopping, local))

        def close(self) -> None:
            self._stopping.append(signal.SIGINT)
            self._frames.close()

    parameters = (*_PARAMETERS, f"camera_file:={json.dumps(str(camera_file))}")
    given = [text for parameter in parameters for text in ("-p", parameter)]
    sys.argv = ["depth_node", "--ros-args", *given]
    local = LocalTopics() if source else None
    nodes: list[Callable[[], Any]] = [FrameNode] if source else []
    return run_nodes([*nodes, partial(IdleDepthNode, local=local)])


class IdlePipeline:
    """Stands in for a `FramePipeline`; its answer is a constant map of the size asked for."""

    def __init__(self) -> None:
        self._answers: dict[Shape, DepthEstimate] = {}

    def __call__(self, frame: Any, size: Shape) -> DepthEstimate:
        """Constant estimate, whatever the frame."""
        if size not in self._answers:
            constant = np.full(size, _DEPTH_M, np.float32)
            self._answers[size] = DepthEstimate(
                *(constant,) * 4, noise=0.002, std_dev_m=constant, seconds={"idle": 0.0}
            )
        return self._answers[size]

    def warm_up(self, shape: Shape) -> None:
        """Prepare nothing."""


@contextlib.contextmanager
def _frames(
    node: Any, camera_file: Path, source: list[str], stopping: list[int], local: Any = None
) -> Iterator[None]:
    """Publish frames in a thread until `stopping` holds something, if there is a source."""
    if not source:
        yield
        return
    publish = frame_sender(node, Path(source[0]), camera_file, local)

    def run() -> None:
        log = publish_until_stopped(publish, float(source[1]), stopping)
        Path(source[2]).write_text(json.dumps(log))

    thread = threading.Thread(target=run, name="frames", daemon=True)
    thread.start()
    try:
        yield
    finally:
        thread.join()


def main() -> int:
    """Run one of the programs."""
    way, camera_file, *source = sys.argv[1:]
    if way == "null":
        run_null(Path(camera_file), source)
        return 0
    return run_depth_node(Path(camera_file), source)


if __name__ == "__main__":
    sys.exit(main())
