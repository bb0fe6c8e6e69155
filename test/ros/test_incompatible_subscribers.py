"""Subscribers whose QoS cannot be met are named, once each."""

import pytest

pytest.importorskip("rclpy")

from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image
from waiting import wait_until

from coded_aperture_ros.ros.depth_node import DepthNode
from coded_aperture_ros.ros.incompatible_subscribers import IncompatibleSubscribers

TRANSIENT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_a_subscriber_that_gets_nothing_is_named_once(ros):
    publisher = ros.publisher("depth/image", Image)
    watch = ros.call(lambda: IncompatibleSubscribers(ros.probe, {"depth/image": publisher}))
    ros.call(watch.close)  # its own timer would be first
    ros.subscribe("depth/image", Image)
    ros.subscribe("depth/image", Image, TRANSIENT)
    found = []
    assert wait_until(lambda: found.extend(watch.find()) or found)
    assert len(found) == 1 and watch.find() == []
    assert found[0].startswith("depth/image: probe subscribes with a QoS that gets no messages")
    assert "ransient" in found[0]


def test_the_wait_set_of_a_node_does_not_grow_with_its_outputs(ros, model):
    node = ros.make(DepthNode, model)
    outputs = len(node.outputs)
    waitables = ros.call(lambda: len(list(node.waitables)))
    assert outputs > 10 and waitables < outputs
