"""Coded frames from RGB-D topics, and the pace of recorded ones."""

import threading
import time

import numpy as np
import pytest
import yaml
from cameras import TINY
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from waiting import scaled, wait_until

from coded_aperture_ros.io.messages import MessageError, array_from_image, millimetres_from_depth
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode
from coded_aperture_ros.ros.messages import image_from_array, stamp_ns
from coded_aperture_ros.ros.rgbd_source import depth_in_metres
from coded_aperture_ros.ros.scheduling import Pace
from coded_aperture_ros.simulation import render_coded_frame

SHAPE = (48, 64)


@pytest.mark.parametrize("encoding", ["32FC1", "16UC1"])
def test_an_rgbd_pair_becomes_a_coded_frame_with_its_truth(ros, tmp_path, encoding):
    camera_file = tmp_path / "camera.yaml"
    camera_file.write_text(yaml.safe_dump(TINY))
    parameters = {"camera_file": str(camera_file), "source": "rgbd", "simulation.noise": 0.0}
    parameters |= {"encoding": "mono16", "publish_clock": True}
    ros.make(CameraDriverNode, parameters)
    coded, truth = ros.subscribe("image_raw", Image), ros.subscribe("ground_truth/depth", Image)
    clock = ros.subscribe("/clock", Clock)
    images, depths = ros.publisher("rgbd/image", Image), ros.publisher("rgbd/depth", Image)
    assert wait_until(lambda: images.get_subscription_count() and depths.get_subscription_count())
    sharp = np.random.default_rng(0).integers(0, 65536, SHAPE, dtype=np.uint16)
    depth = np.full(SHAPE, 3.0, np.float32)
    depth[:, :20] = 2.2
    stored = depth if encoding == "32FC1" else millimetres_from_depth(depth)
    header = Header(frame_id="gazebo")
    header.stamp.sec, header.stamp.nanosec = 77, 5
    images.publish(image_from_array(sharp, "mono16", header))
    depths.publish(image_from_array(stored, encoding, header))
    assert wait_until(lambda: coded and truth and clock)
    assert stamp_ns(coded[0].header) == stamp_ns(truth[0].header) == 77_000_000_005
    assert clock[0].clock == header.stamp
    np.testing.assert_allclose(array_from_image(truth[0]), depth, rtol=1e-6)
    expected = render_coded_frame(sharp / np.float32(65535), depth, load_camera(camera_file))
    np.testing.assert_allclose(array_from_image(coded[0]) / 65535, expected, atol=2e-5)


class Pairs:
    """A driver of RGB-D pairs, and publishers of them."""

    def __init__(self, ros, folder):
        (folder / "camera.yaml").write_text(yaml.safe_dump(TINY))
        parameters = {"camera_file": str(folder / "camera.yaml"), "source": "rgbd"}
        self.node = ros.make(CameraDriverNode, parameters)
        self.coded = ros.subscribe("image_raw", Image)
        self.images = ros.publisher("rgbd/image", Image)
        self.depths = ros.publisher("rgbd/depth", Image)
        assert wait_until(
            lambda: self.images.get_subscription_count() and self.depths.get_subscription_count()
        )

    def send(self, second, shape=SHAPE):
        """Publish a picture, and depth of a shape, which is to be that of the picture."""
        header = Header()
        header.stamp.sec = second
        self.images.publish(image_from_array(np.full(SHAPE, 99, np.uint8), "mono8", header))
        self.depths.publish(image_from_array(np.full(shape, 2.5, np.float32), "32FC1", header))

    @property
    def failed(self):
        return self.node.statistics.summary().rejected.get("source", 0)


def test_pairs_that_cannot_be_used_are_told_and_the_next_is_taken(ros, tmp_path):
    pairs = Pairs(ros, tmp_path)
    pairs.send(1, (24, 64))
    assert wait_until(lambda: "one size" in pairs.node.statistics.summary().last_error)
    pairs.send(2)
    assert wait_until(lambda: pairs.coded)
    assert pairs.coded[0].header.stamp.sec == 2


@pytest.mark.slow
def test_pairs_that_come_do_not_wait_for_those_that_do_not(ros, tmp_path, capfd):
    pairs = Pairs(ros, tmp_path)
    assert wait_until(lambda: pairs.failed == 4)  # one a second
    began = time.monotonic()
    pairs.send(1)
    assert wait_until(lambda: len(pairs.coded) == 1)
    for second in range(2, 8):
        failed = pairs.failed
        pairs.send(second, (24, 64))
        assert wait_until(lambda n=failed: pairs.failed > n)
        pairs.send(second + 10)
        assert wait_until(lambda n=second: len(pairs.coded) == n)
    assert time.monotonic() - began < scaled(2.5)
    errors = [line for line in capfd.readouterr().err.splitlines() if "[ERROR]" in line]
    assert len(errors) == 1


def test_depth_without_a_distance_is_refused():
    nothing = image_from_array(np.zeros(SHAPE, np.uint16), "16UC1", Header())
    with pytest.raises(MessageError, match="no depth is known"):
        depth_in_metres(nothing)
    with pytest.raises(MessageError, match="rgb8"):
        depth_in_metres(image_from_array(np.zeros((*SHAPE, 3), np.uint8), "rgb8", Header()))


def waits(pace, *frames):
    began = time.monotonic()
    for period_s, stamp in frames:
        pace.wait(period_s, stamp)
    return time.monotonic() - began


def test_recorded_frames_keep_their_own_pace():
    pace = Pace(threading.Event())
    stamps = [1_000_000_000 + 100_000_000 * frame for frame in range(4)]
    assert 0.29 < waits(pace, *((9.0, stamp) for stamp in stamps)) < scaled(5)
    assert waits(pace, (0.01, stamps[0])) < scaled(1)  # begins again: a period, and no step back
    assert waits(pace, (0.01, stamps[0] + 10**12)) < scaled(1)  # a long pause is not waited for


def test_stopping_ends_the_wait():
    stopping = threading.Event()
    stopping.set()
    assert waits(Pace(stopping), (60.0, None), (60.0, None)) < scaled(5)
