"""A gyroscope's messages as the expected motion of a frame."""

import math

import numpy as np
import pytest
import yaml
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image, Imu
from small_camera import CAMERA as SMALL
from small_camera import FAR_M, NEAR_M, coded_wall
from std_msgs.msg import Header
from waiting import wait_until

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.messages import array_from_image, pixels_from_frame
from coded_aperture_ros.optics import Intrinsics, load_camera
from coded_aperture_ros.optics.rotation import parse_imu_axes
from coded_aperture_ros.ros.depth_node import DepthNode
from coded_aperture_ros.ros.gyro import Gyro, GyroConfig
from coded_aperture_ros.ros.messages import image_from_array

CAMERA = Intrinsics.pinhole(500.0, 640, 480)


def said(nanoseconds, x=0.0, y=0.0, z=0.0):
    message = Imu()
    message.header.stamp.nanosec = nanoseconds
    rate = message.angular_velocity
    rate.x, rate.y, rate.z = x, y, z
    return message


def frame(nanoseconds):
    header = Header()
    header.stamp.nanosec = nanoseconds
    return header


def test_the_message_nearest_in_time_counts_and_its_axes_are_turned():
    gyro = Gyro()
    for nanoseconds, yaw in ((0, 9.0), (40_000_000, 0.5), (90_000_000, 7.0)):
        gyro.receive(said(nanoseconds, z=yaw))
    expected = gyro.expected(frame(50_000_000), GyroConfig(exposure_s=0.02), CAMERA)
    # Turning left, around the axis that points up, by 0.01 rad: the picture moves to the right.
    assert expected.angle_rad == pytest.approx((0.0, -0.01, 0.0))
    right, down = expected.motion_px([240], [320], 640)[0, 0]
    assert (right, abs(down)) == (pytest.approx(5.0, rel=0.01), pytest.approx(0, abs=0.1))
    aligned = GyroConfig(exposure_s=0.02, imu_axes="x y z")
    assert gyro.expected(frame(50_000_000), aligned, CAMERA).angle_rad == pytest.approx(
        (0, 0, 0.01)
    )


def test_turns_are_added_up_and_have_no_place():
    gyro = Gyro()
    assert gyro.pose(0, GyroConfig()) is None
    for nanoseconds in range(0, 200_000_001, 10_000_000):
        gyro.receive(said(nanoseconds, z=2.0))
    gyro.receive(said(100_000_000, z=9.0))  # late
    first, second = (gyro.pose(stamp, GyroConfig()) for stamp in (15_000_000, 115_000_000))
    assert np.isnan(second[:3, 3]).all()
    turned = first[:3, :3].T @ second[:3, :3]
    # To the left, around the camera's axis that points down, by 0.2 rad.
    assert turned[2] == pytest.approx([math.sin(0.2), 0, math.cos(0.2)], abs=1e-4)
    assert gyro.pose(400_000_000, GyroConfig()) is None
    gyro.forget()
    assert gyro.pose(100_000_000, GyroConfig()) is None


@pytest.mark.parametrize(
    ("message", "exposure_s", "reason"),
    [
        (None, 0.02, "no angular velocity"),
        (said(0, z=1.0), 0.0, "exposure"),
        (said(0, z=math.nan), 0.02, "not finite"),
        (said(0, z=math.inf), 0.02, "not finite"),
        (said(900_000_000, z=1.0), 0.02, "late"),
    ],
)
def test_what_says_nothing_says_why(message, exposure_s, reason):
    gyro = Gyro()
    if message is not None:
        gyro.receive(message)
    expected = gyro.expected(frame(0), GyroConfig(exposure_s=exposure_s), CAMERA)
    assert expected.angle_rad is None
    assert reason in expected.reason


def test_what_was_said_before_time_went_back_does_not_count():
    gyro = Gyro()
    gyro.receive(said(0, z=1.0))
    gyro.forget()
    assert gyro.expected(frame(0), GyroConfig(exposure_s=0.02), CAMERA).angle_rad is None


def motion_node(ros, folder, **changes):
    """Start a node that finds motion; return it, and the pixels of a frame for it."""
    camera = folder / "camera.yaml"
    camera.write_text(yaml.safe_dump(SMALL))
    settings = {
        "camera_file": str(camera),
        "near_m": NEAR_M,
        "far_m": FAR_M,
        "method": "motion",
        "learn.level_count": 6,
        "learn.window_px": 32,
        "learn.rank": 32,
        "motion.directions": 2,
        "motion.lengths": 2,
        "motion.longest_px": 6.0,
    }
    pixels = pixels_from_frame(coded_wall(load_camera(camera)), "mono8")
    return ros.make(DepthNode, settings | changes), pixels


def send_frame(images, pixels, seconds):
    header = Header()
    header.stamp.sec = seconds
    images.publish(image_from_array(pixels, "mono8", header))


def test_the_node_finds_motion_and_says_what_it_knew_of_it(ros, tmp_path):
    node, pixels = motion_node(ros, tmp_path, **{"motion.exposure_s": 0.02})
    depths, motions = ros.subscribe("depth/image", Image), ros.subscribe("depth/motion", Image)
    images, imu = ros.publisher("image_raw", Image), ros.publisher("imu", Imu)
    assert wait_until(lambda: images.get_subscription_count() and imu.get_subscription_count())

    def send(seconds):
        count = len(motions)
        send_frame(images, pixels, seconds)
        assert wait_until(lambda: len(motions) > count)
        return node.identity()["motion"]

    assert "no angular velocity" in send(10)
    message = said(0, z=0.001)
    message.header.stamp.sec = 11
    imu.publish(message)
    assert wait_until(lambda: node._gyro._rates)
    assert send(11) == ""
    assert "late" in send(12)
    assert motions[0].encoding == "32FC2"
    assert motions[0].step == 8 * motions[0].width
    field = np.frombuffer(motions[1].data, np.float32).reshape(motions[1].height, -1, 2)
    assert np.isfinite(field).any()
    assert np.nanmedian(np.hypot(field[..., 0], field[..., 1])) < 2  # the wall stands still
    assert wait_until(lambda: len(depths) == 3)


def test_motion_with_the_nearest_depth_where_it_is_unknown(ros, tmp_path):
    """The setting of a moving robot that must not run into anything."""
    node, pixels = motion_node(ros, tmp_path, **{"confidence.unknown": "nearest"})
    depths, images = ros.subscribe("depth/image", Image), ros.publisher("image_raw", Image)
    assert wait_until(images.get_subscription_count)
    for seconds, smoothness in ((10, 1.0), (11, 2.0)):
        setting = Parameter("motion.smoothness", value=smoothness)
        assert node.set_parameters([setting])[0].successful
        send_frame(images, pixels, seconds)
        assert wait_until(lambda count=seconds - 9: len(depths) == count)
    assert node.statistics.summary().rejected == {}
    assert not np.isnan(array_from_image(depths[0])).any()


@pytest.mark.parametrize("axes", ["x y", "x y y", "x y w", "x y z z", "", "xy z x", "x y -z"])
def test_axes_that_are_no_rotation_are_refused(axes):
    with pytest.raises(InputError, match="imu_axes"):
        parse_imu_axes(axes)
