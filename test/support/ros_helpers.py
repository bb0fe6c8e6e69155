"""What the tests of the nodes share: a context and an executor of their own."""

import gc
import os
import subprocess
import sys
import warnings
from unittest import mock

import rclpy
import yaml
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from waiting import wait_until

from coded_aperture_ros.ros.running import ExecutorThread

with warnings.catch_warnings():
    # Imported by rclpy with the first message; uses modules that Python has deprecated.
    warnings.simplefilter("ignore", DeprecationWarning)
    import rosidl_generator_py  # noqa: F401


def start_node(node, parameters, *arguments, **options):
    """Start one of the package's nodes as a program; `options` are those of `Popen`."""
    command = [sys.executable, "-m", "coded_aperture_ros.ros.programs", node, "--ros-args"]
    for name, value in parameters.items():
        command += ["-p", f"{name}:={yaml.safe_dump(value).splitlines()[0]}"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen([*command, *arguments], env=environment, **options)


# Without shared memory: a program that is killed or stopped while it sends holds the lock of the
# receiver's port. Fast DDS 2.14 then makes the port anew, in a thread, and a participant that is
# removed meanwhile waits for the lock in memory that is no longer mapped: a segmentation fault.
UDP_ALONE = {
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",  # as in the profile of `conftest.py`
    "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
}


class Ros:
    """A ROS context of a test's own, whose nodes all spin in one thread.

    It hears the programs that a test starts over UDP; these hear each other as on a robot.
    """

    def __init__(self):
        self.context = Context()
        with mock.patch.dict(os.environ, UDP_ALONE):
            rclpy.init(context=self.context)
            self.executor = SingleThreadedExecutor(context=self.context)
            self.nodes = []
            self.echoes = {}
            self.probe = self.add(Node("probe", context=self.context))
        self.spinner = ExecutorThread(self.executor, "executor")

    def add(self, node):
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def make(self, node_type, parameters=(), **options):
        """Make one of the package's nodes with these parameters."""
        overrides = [Parameter(name, value=value) for name, value in dict(parameters).items()]
        return self.add(node_type(context=self.context, parameter_overrides=overrides, **options))

    def subscribe(self, topic, message_type, qos=10):
        """Return the list that a topic's messages are appended to."""
        received = []
        self.probe.create_subscription(message_type, topic, received.append, qos)
        return received

    def publisher(self, topic, message_type, qos=None):
        return self.probe.create_publisher(message_type, topic, qos or QoSProfile(depth=10))

    def hand_over(self, publisher, message):
        """Publish a message; return once those who subscribe in this context have taken it."""
        topic = publisher.topic_name
        if topic not in self.echoes:
            count = publisher.get_subscription_count()
            self.echoes[topic] = self.subscribe(topic, type(message), 100)
            assert wait_until(lambda: publisher.get_subscription_count() > count)
        echo = self.echoes[topic]
        before = len(echo)
        publisher.publish(message)
        # All readers of a participant get it at once; the executor comes to each of them in turn.
        assert wait_until(lambda: len(echo) > before)
        for _ in range(2):
            self.call(lambda: None)

    def remove(self, node):
        """Take a node away, in the thread that spins."""

        def end():
            self.executor.remove_node(node)
            node.close()
            node.destroy_node()

        self.call(end)
        self.nodes.remove(node)

    def call(self, function):
        """Call a function in the thread that spins, as services do, and return what it returns.

        A transition takes publishers away, which the executor must not be waiting for meanwhile.
        """
        task = self.executor.create_task(function)
        self.executor.wake()
        assert wait_until(task.done)
        return task.result()

    def close(self):
        for node in self.nodes:
            if hasattr(node, "close"):
                node.close()
        self.spinner.stop()
        for node in self.nodes:
            node.destroy_node()
        self.context.try_shutdown()
        # Removes the participant now, and not when the garbage is collected some time.
        self.nodes.clear()
        failed = self.spinner.failed
        del self.probe, self.executor, self.spinner
        self.context.destroy()
        gc.collect()
        assert not failed, "a callback raised an error: see above"
