"""The processes of a node that is measured, and the subscriber that watches it."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from coded_aperture_ros.core.errors import InputError

TOPIC = "depth/image"

_START_TIMEOUT_S = 60.0
_FRAMES_TO_START = 3
_SPIN_S = 0.1
_LAST_LINES = 15


@contextlib.contextmanager
def ros_node(name: str) -> Iterator[tuple[Any, Any]]:
    """Run a node in a context of its own; yield it and its context."""
    # Only now: rclpy reads the environment when it is imported and started.
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions

    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = Node(name, context=context)
        try:
            yield node, context
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()


class Listener:
    """Writes down when depth images come, and what the depth node reports.

    Parameters
    ----------
    node : rclpy.node.Node
    executor : rclpy.executors.Executor
        The node's.
    reliable : bool
        Ask for lost images again.
    """

    def __init__(self, node: Any, executor: Any, reliable: bool) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import Image

        self.received: dict[int, int] = {}
        self.statuses: list[tuple[int, dict[str, str]]] = []
        self._executor = executor
        policy = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        qos = QoSProfile(depth=5, reliability=policy)
        node.create_subscription(Image, TOPIC, self._on_depth, qos)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def listen(self, seconds: float, processes: Sequence["Process"]) -> None:
        """Receive for some time; an `InputError` if a process has ended meanwhile."""
        deadline_s = time.monotonic() + seconds
        while (left_s := deadline_s - time.monotonic()) > 0:
            self._executor.spin_once(min(left_s, _SPIN_S))
            for process in processes:
                process.check()

    def _on_depth(self, message: Any) -> None:
        now_ns = time.time_ns()
        stamp = message.header.stamp
        self.received[stamp.sec * 1_000_000_000 + stamp.nanosec] = now_ns

    def _on_diagnostics(self, message: Any) -> None:
        now_ns = time.time_ns()
        for status in message.status:
            if status.name.startswith("depth_node:"):
                self.statuses.append((now_ns, {pair.key: pair.value for pair in status.values}))


@contextlib.contextmanager
def listener(reliable: bool) -> Iterator[Listener]:
    """Run the subscriber."""
    with ros_node("node_rate") as (node, context):
        from rclpy.executors import SingleThreadedExecutor

        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        try:
            yield Listener(node, executor, reliable)
        finally:
            executor.shutdown()


class Process:
    """A program that does not outlive the `with` block.

    Parameters
    ----------
    arguments : sequence of str
        Command line after the Python interpreter.
    log_file : Path
        Where everything goes that it says.
    """

    def __init__(self, arguments: Sequence[str], log_file: Path) -> None:
        self._name = log_file.stem
        self._log_file = log_file
        with log_file.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            )
        self.pid = self._process.pid

    def __enter__(self) -> "Process":
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def interrupt(self) -> None:
        """Tell the program to end, as Ctrl-C does, and do not wait for it."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)

    def end(self) -> None:
        """End the program, by force if it takes more than five seconds."""
        try:
            self.interrupt()
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            pass
        finally:
            if self._process.poll() is None:
                self._process.kill()
                self._process.wait()

    def check(self) -> None:
        """Raise an `InputError` with the last lines of the program if it has ended."""
        if self._process.poll() is not None:
            status = self._process.returncode
            raise InputError(f"{self._name} ended with status {status}:{self.said()}")

    def said(self) -> str:
        """Return the last lines that the program has written."""
        lines = self._log_file.read_text(errors="replace").splitlines()[-_LAST_LINES:]
        return "".join(f"\n    {line}" for line in lines)


def wait_for_depth(listener: Listener, processes: Sequence[Process]) -> None:
    """Receive until depth images come."""
    deadline_s = time.monotonic() + _START_TIMEOUT_S
    while len(listener.received) < _FRAMES_TO_START:
        listener.listen(_SPIN_S, processes)
        if time.monotonic() > deadline_s:
            said = "".join(process.said() for process in processes)
            raise InputError(f"no depth images in {_START_TIMEOUT_S:g} s{said}")
