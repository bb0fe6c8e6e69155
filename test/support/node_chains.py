"""One of the nodes with publishers of what it takes and lists of what it gives."""

import itertools

import numpy as np
from sensor_msgs.msg import CameraInfo, Image
from small_camera import DEPTH_M, HEIGHT, WIDTH
from std_msgs.msg import Header
from waiting import wait_until

from coded_aperture_ros.io.messages import pixels_from_frame
from coded_aperture_ros.ros.deblur_node import DeblurNode
from coded_aperture_ros.ros.depth_node import DepthNode
from coded_aperture_ros.ros.messages import image_from_array

DEPTH_OUTPUTS = {
    "depth/image": Image,
    "depth/image_raw": Image,
    "depth/confidence": Image,
    "depth/std_dev": Image,
    "depth/camera_info": CameraInfo,
}
# Only with free_space.risk.
FREE_SPACE = "depth/free_space"
# Only with second_surface.enabled.
SECOND = ("depth/second", "depth/second_share")
STAMPS = itertools.count(1000)


def stamped(seconds=None):
    """Return the header of a frame, with a later stamp than any before unless one is given."""
    header = Header(frame_id="front_optical_frame")
    header.stamp.sec, header.stamp.nanosec = seconds or next(STAMPS), 987_654_321
    return header


def mono8(frame, header=None):
    return image_from_array(pixels_from_frame(frame, "mono8"), "mono8", header or stamped())


def wall(header, size=(HEIGHT // 2, WIDTH // 2), depth_m=DEPTH_M):
    """Return the depth image of a wall."""
    return image_from_array(np.full(size, depth_m, np.float32), "32FC1", header)


class Chain:
    """A depth node, everything that it publishes, and a publisher of frames."""

    def __init__(self, ros, model, subscribe=tuple(DEPTH_OUTPUTS), **parameters):
        self.ros = ros
        self.node = ros.make(DepthNode, {**model, **parameters})
        self.received = {t: ros.subscribe(t, DEPTH_OUTPUTS.get(t, Image)) for t in subscribe}
        self.images = ros.publisher("image_raw", Image)
        self.infos = ros.publisher("camera_info", CameraInfo)
        if subscribe:
            assert wait_until(self.connected)

    def connected(self):
        return self.images.get_subscription_count() and self.infos.get_subscription_count()

    def tell(self, *infos):
        """Publish camera_info, each so that the nodes have it before the next."""
        for info in infos:
            self.ros.hand_over(self.infos, info)

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


class DeblurChain:
    """A deblur node, what it publishes, and publishers of frames and their depth."""

    def __init__(self, ros, model, **parameters):
        self.ros = ros
        self.node = ros.make(DeblurNode, {**model, **parameters})
        self.received = ros.subscribe("deblurred/image", Image)
        self.infos = ros.subscribe("deblurred/camera_info", CameraInfo)
        self.images = ros.publisher("image_raw", Image)
        self.depths = ros.publisher("depth/image", Image)
        assert wait_until(self.connected)

    def connected(self):
        return self.images.get_subscription_count() and self.depths.get_subscription_count()

    def result(self, frame):
        """Send a frame with the depth of a wall, and return what comes of it."""
        count = len(self.received)
        self.images.publish(frame)
        self.depths.publish(wall(frame.header))
        assert wait_until(lambda: len(self.received) > count), "nothing came of the frame"
        return self.received[-1]
