"""A gyroscope's messages as the expected motion of a frame."""

import math

import pytest
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from coded_aperture_ros.errors import InputError
from coded_aperture_ros.nodes.gyro import Gyro, GyroConfig, rotation_of
from coded_aperture_ros.optics import Intrinsics

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
    right, down = expected.at([240], [320], 640)[0, 0]
    assert (right, abs(down)) == (pytest.approx(5.0, rel=0.01), pytest.approx(0, abs=0.1))
    aligned = GyroConfig(exposure_s=0.02, imu_axes="x y z")
    assert gyro.expected(frame(50_000_000), aligned, CAMERA).angle_rad == pytest.approx(
        (0, 0, 0.01)
    )


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


@pytest.mark.parametrize("axes", ["x y", "x y y", "x y w", "x y z z", "", "xy z x", "x y -z"])
def test_axes_that_are_no_rotation_are_refused(axes):
    with pytest.raises(InputError, match="imu_axes"):
        rotation_of(axes)
