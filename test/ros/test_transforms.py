"""Poses from odometry and /tf: as messages tell them, and in depth_node over DDS."""

import math
import types

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from node_chains import Chain, mono8, stamped
from rclpy.parameter import Parameter
from small_camera import DEPTH_M
from waiting import wait_until

from coded_aperture_ros.io.messages import Transforms

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # it is not on PyPI; the message is a list of transforms
    TFMessage = types.SimpleNamespace

PARENT, CHILD, CAMERA = "odom", "base_link", "front_optical_frame"


def transform(seconds, x=0.0, yaw=0.0, parent=PARENT, child=CHILD):
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.header.stamp.sec = int(seconds)
    message.header.stamp.nanosec = round((seconds % 1) * 1e9)
    message.transform.translation.x = x
    message.transform.rotation.z = math.sin(yaw / 2)
    message.transform.rotation.w = math.cos(yaw / 2)
    return message


def told(*messages, static=()):
    transforms = Transforms()
    transforms.receive_static(TFMessage(transforms=list(static)))
    for message in messages:
        transforms.receive(TFMessage(transforms=[message]))
    return transforms


def at(seconds):
    return round(seconds * 1e9)


def test_a_pose_is_interpolated():
    transforms = told(transform(10, 1.0, 0.0), transform(11, 2.0, 0.4))
    pose = transforms.pose(PARENT, CHILD, at(10.5))
    assert pose[0, 3] == pytest.approx(1.5)
    assert math.atan2(pose[1, 0], pose[0, 0]) == pytest.approx(0.2, abs=1e-3)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)


def test_the_shorter_way_round_is_interpolated():
    after = transform(11, yaw=0.2)
    for name in "xyzw":  # the same rotation
        setattr(after.transform.rotation, name, -getattr(after.transform.rotation, name))
    pose = told(transform(10), after).pose(PARENT, CHILD, at(10.5))
    assert math.atan2(pose[1, 0], pose[0, 0]) == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize(("seconds", "x"), [(9.9, None), (10.0, 0.0), (11.05, 1.05), (11.2, None)])
def test_only_a_little_is_extrapolated(seconds, x):
    pose = told(transform(10, 0.0), transform(11, 1.0)).pose(PARENT, CHILD, at(seconds))
    assert pose is None if x is None else pose[0, 3] == pytest.approx(x)


def test_chains_meet_where_they_can():
    mast = transform(0, 0.5, parent=CHILD, child="camera")
    map_ = transform(0, 3.0, parent="map", child=PARENT)
    transforms = told(transform(10, 1.0), static=(mast, map_))
    assert transforms.pose("map", "camera", at(10))[0, 3] == pytest.approx(4.5)
    assert transforms.pose("/odom", "/camera", at(10))[0, 3] == pytest.approx(1.5)
    assert transforms.pose("camera", "odom", at(10))[0, 3] == pytest.approx(-1.5)
    assert transforms.pose("elsewhere", "camera", at(10)) is None
    assert transforms.pose("map", "camera", at(99)) is None


def test_circles_and_broken_messages_are_left_out():
    broken = transform(11)
    broken.transform.translation.x = math.nan
    unset = transform(12)
    unset.transform.rotation.w = 0.0
    circle = transform(0, parent=CHILD, child=PARENT)
    transforms = told(transform(10, 1.0), broken, unset, static=(circle,))
    assert transforms.pose(PARENT, CHILD, at(10)) is not None
    assert transforms.pose("map", CHILD, at(10)) is None
    assert told(broken).pose(PARENT, CHILD, at(11)) is None


def test_late_and_old_transforms():
    transforms = told(*(transform(second, float(second)) for second in (10, 11, 10.5, 25)))
    assert transforms.pose(PARENT, CHILD, at(10.5)) is None  # forgotten after ten seconds
    transforms.forget()
    assert transforms.pose(PARENT, CHILD, at(25)) is None


def shifted(coded, pixels):
    """The frame after the camera has moved to the right before a wall."""
    return np.roll(coded, -pixels, axis=1)


def odometry(seconds, x, child=CAMERA, covariance=None):
    message = Odometry(child_frame_id=child)
    if covariance is not None:
        message.pose.covariance = np.ravel(covariance)
    where = transform(seconds, x)
    message.header = where.header
    message.pose.pose.position.x = x
    message.pose.pose.orientation = where.transform.rotation
    return message


def test_a_pose_of_odometry():
    transforms = told(static=(transform(0, 0.5, parent=CHILD, child=CAMERA),))
    transforms.receive_odometry(odometry(10, 1.0, child=CHILD))
    assert transforms.pose(PARENT, CAMERA, at(10))[0, 3] == pytest.approx(1.5)


def test_a_covariance_is_that_of_the_camera():
    """A mast of a metre ahead: what turns the robot about z moves the camera along y."""
    transforms = told(static=(transform(0, 1.0, parent=CHILD, child=CAMERA),))
    turns = np.diag([0, 0, 0, 0, 0, 0.01])
    for seconds, factor in ((10, 1.0), (11, 3.0)):
        transforms.receive_odometry(odometry(seconds, 1.0, CHILD, factor * turns))
    found = transforms.located(PARENT, CAMERA, at(10.5)).covariance  # between both
    expected = np.zeros((6, 6))
    expected[np.ix_([1, 5], [1, 5])] = 0.02
    np.testing.assert_allclose(found, expected, atol=1e-12)
    late = transforms.located(PARENT, CAMERA, at(11.05)).covariance
    assert late[5, 5] == pytest.approx(0.03)  # it is not extrapolated
    # About the axes of another fixed frame, which is exact.
    transforms.receive_static(TFMessage(transforms=[transform(0, 5.0, math.pi / 2, "map", PARENT)]))
    turned = transforms.located("map", CAMERA, at(10.5)).covariance
    assert turned[0, 0] == pytest.approx(0.02) and turned[1, 1] == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(
    "covariance",
    [np.zeros((6, 6)), np.diag([-1.0, 0, 0, 0, 0, 0]), np.full((6, 6), math.nan), np.eye(6)[::-1]],
)
def test_a_covariance_that_states_nothing_is_unknown(covariance):
    transforms = told()
    transforms.receive_odometry(odometry(10, 1.0, CHILD, covariance))
    found = transforms.located(PARENT, CHILD, at(10))
    assert found.matrix[0, 3] == 1.0 and found.covariance is None


def test_tf_has_no_covariance_unless_odometry_has_the_same_transform():
    for first in (False, True):
        transforms = told()
        for by_tf in (first, not first):
            if by_tf:
                transforms.receive(TFMessage(transforms=[transform(10, 1.0)]))
                continue
            transforms.receive_odometry(odometry(10, 1.0, CHILD, np.eye(6)))
        assert transforms.located(PARENT, CHILD, at(10)).covariance is not None
    assert told(transform(10, 1.0)).located(PARENT, CHILD, at(10)).covariance is None


def run_past(ros, model, coded, tell, frames=4, step_px=4, covariance=lambda _: None):
    """Send frames of a wall that a camera passes; return what the node says of its motion."""
    settings = {"temporal.moving_camera": "pose", "temporal.frames": 8.0}
    chain = Chain(ros, model, ("depth/image",), **settings)
    poses = ros.publisher("odometry", Odometry)
    assert wait_until(poses.get_subscription_count)
    said = []
    for index in range(frames):
        header = stamped()
        seconds = header.stamp.sec + header.stamp.nanosec * 1e-9
        x = tell(index, index * step_px / 400 * DEPTH_M)
        if x is not None:
            ros.hand_over(poses, odometry(seconds, x, covariance=covariance(index)))
        chain.result(mono8(shifted(coded, index * step_px), header))
        said.append(chain.node.identity()["camera_motion"])
    return said


def test_a_node_takes_poses_of_odometry(ros, model, coded):
    said = run_past(ros, model, coded, lambda _, x: x)
    assert said[0] == "unknown: the memory begins"
    assert said[1:] == ["told by the pose"] * 3


def test_a_node_tells_the_way_that_it_finds(ros, model, coded):
    ways = ros.subscribe("depth/odometry", Odometry)
    said = run_past(ros, model, coded, lambda *_: None)
    assert said[1:] == ["found in the frames"] * 3
    assert wait_until(lambda: len(ways) == 3)
    way = ways[-1]
    assert (way.header.frame_id, way.child_frame_id) == (f"{CAMERA}_start", CAMERA)
    # Before a wall, a narrow view hardly tells a step to the side from a turn: it says so.
    step_m, velocity = 4 / 400 * DEPTH_M, way.twist.twist  # a frame a second
    assert velocity.linear.x + velocity.angular.y * DEPTH_M == pytest.approx(step_m, rel=0.1)
    assert abs(velocity.linear.x - step_m) < 3 * math.sqrt(way.twist.covariance[0])
    assert way.pose.covariance[0] > way.twist.covariance[0] > 0


def test_a_node_does_without_poses(ros, model, coded):
    said = run_past(ros, model, coded, lambda index, x: x if index < 2 else None)
    assert said[1] == "told by the pose"
    assert said[2:] == ["found in the frames"] * 2


def test_a_node_refuses_poses_that_frames_contradict(ros, model, coded):
    said = run_past(ros, model, coded, lambda index, x: x + 0.1 * (index == 3))
    assert said[2] == "told by the pose"
    assert said[3] == "found in the frames, the pose contradicts the frames"


def test_a_jump_beyond_the_covariance_is_refused(ros, model, coded):
    told = {"covariance": lambda index: np.eye(6) * (1e-6 + 1e-8 * index)}
    said = run_past(ros, model, coded, lambda index, x: x + 0.1 * (index == 3), **told)
    assert said[2] == "told by the pose"
    assert said[3] == "found in the frames, the pose contradicts the frames"


def test_a_node_takes_odometry_that_states_how_far_it_may_be_off(ros, model, coded):
    """Slip of a decimetre, which the covariance grows by, is mended by the frames."""
    ways = ros.subscribe("depth/odometry", Odometry)

    def tell(index, x):
        return None if index == 1 else x + 0.1 * (index > 2)  # one is missing

    def covariance(index):
        return np.diag([1e-6 + 0.01 * (index > 2), 1e-6, 1e-6, 1e-8, 1e-8, 1e-8])

    said = run_past(ros, model, coded, tell, frames=5, covariance=covariance)
    assert said[1] == "found in the frames"
    assert said[3:] == ["told by the pose"] * 2
    assert wait_until(lambda: len(ways) == 4)
    step_m = 4 / 400 * DEPTH_M
    assert ways[-2].twist.twist.linear.x == pytest.approx(step_m, abs=0.02)


def test_poses_cannot_be_asked_for_later_without_a_word(ros, model, coded):
    chain = Chain(ros, model, ("depth/image",))
    (changed,) = chain.node.set_parameters([Parameter("temporal.moving_camera", value="pose")])
    assert changed.successful
    for _ in range(2):
        chain.result(mono8(coded))
    assert chain.node.identity()["camera_motion"] == "found in the frames"
    (refused,) = chain.node.set_parameters([Parameter("temporal.frames", value=0.0)])
    assert not refused.successful and "needs temporal_frames: more than 0" in refused.reason
