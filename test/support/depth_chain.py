"""A depth node between a publisher of frames and subscribers, over real DDS."""

import itertools

from ros_helpers import wait_until
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from coded_aperture_ros.ros.depth_node import DepthNode
from coded_aperture_ros.ros.messages import image_from_array, pixels_from_frame

DEPTH_OUTPUTS = {
    "depth/image": Image,
    "depth/image_raw": Image,
    "depth/confidence": Image,
    "depth/camera_info": CameraInfo,
}


STAMPS = itertools.count(1)


def stamped():
    header = Header(frame_id="front_optical_frame")
    header.stamp.sec, header.stamp.nanosec = next(STAMPS), 987_654_321
    return header


def mono8(frame, header=None):
    return image_from_array(pixels_from_frame(frame, "mono8"), "mono8", header or stamped())


class Chain:
    """A depth node, everything that it publishes, and a publisher of frames."""

    def __init__(self, ros, model, subscribe=tuple(DEPTH_OUTPUTS), **parameters):
        self.ros = ros
        self.node = ros.make(DepthNode, {**model, **parameters})
        self.received = {t: ros.subscribe(t, DEPTH_OUTPUTS[t]) for t in subscribe}
        self.images = ros.publisher("image_raw", Image)
        self.infos = ros.publisher("camera_info", CameraInfo)
        if subscribe:
            assert wait_until(self.connected)

    def connected(self):
        return self.images.get_subscription_count() and self.infos.get_subscription_count()

    def send(self, message):
        """Send a message and wait until the node is done with it."""
        before = self.handled()
        self.images.publish(message)
        assert wait_until(lambda: self.handled() > before), "the node did not react"

    def handled(self):
        summary = self.node.statistics.summary()
        return summary.processed + summary.rejected_total + summary.dropped

    def result(self, message, topic="depth/image"):
        """Send a frame and return what comes of it on a topic."""
        count = len(self.received[topic])
        self.send(message)
        assert wait_until(lambda: len(self.received[topic]) > count)
        return self.received[topic][-1]

    @property
    def rejected(self):
        return self.node.statistics.summary().rejected
