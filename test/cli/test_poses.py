"""Poses from bags and files, for `bag` and `depth`."""

import dataclasses
import pickle

import numpy as np
import pytest
from bag_scene import (
    FRAME_ID,
    PERIOD_NS,
    START_NS,
    STORE,
    TF,
    header,
    recording,
    transform,
    write_bag,
)
from cli_scene import call, refused, wrong_usage

from coded_aperture_ros.bags.poses import ODOMETRY_TYPE, BagPoses
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.moving import MovingMemory
from coded_aperture_ros.frames.pose import Pose
from coded_aperture_ros.io import write_image
from coded_aperture_ros.io.pose_file import PoseFile

MOVING = ("--temporal-frames", 4, "--moving-camera", "pose")
# The camera looks along x of the robot.
MOUNTED = (0.1, 0.0, 0.3), (-0.5, 0.5, -0.5, 0.5)
STEP_M = 0.01


def kind(name):
    return STORE.types[name]


def odometry(index, place):
    pose = kind("geometry_msgs/msg/Pose")(
        position=kind("geometry_msgs/msg/Point")(*place),
        orientation=kind("geometry_msgs/msg/Quaternion")(0.0, 0.0, 0.0, 1.0),
    )
    still = kind("geometry_msgs/msg/Vector3")(0.0, 0.0, 0.0)
    twist = kind("geometry_msgs/msg/Twist")(linear=still, angular=still)
    message = kind(ODOMETRY_TYPE)(
        header=dataclasses.replace(header(index), frame_id="odom"),
        child_frame_id="base_link",
        pose=kind("geometry_msgs/msg/PoseWithCovariance")(pose, np.zeros(36)),
        twist=kind("geometry_msgs/msg/TwistWithCovariance")(twist, np.zeros(36)),
    )
    return STORE.serialize_cdr(message, ODOMETRY_TYPE)


def walked(scene, path, *, by_odometry=False, mounted=True):
    """A bag of a camera on a robot that goes along x; its poses are recorded after the frames."""
    messages = recording(scene, frames=3)
    if mounted:
        static = transform(0, "base_link", FRAME_ID, *MOUNTED)
        messages.append(("/tf_static", TF, START_NS, static))
    for index in range(4):
        place, time_ns = (STEP_M * index, 0.0, 0.0), START_NS + index * PERIOD_NS + 9_000_000
        if by_odometry:
            messages.append(("/wheels", ODOMETRY_TYPE, time_ns, odometry(index, place)))
        else:
            messages.append(("/tf", TF, time_ns, transform(index, "odom", "base_link", place)))
    return write_bag(path, sorted(messages, key=lambda message: message[2]))


@pytest.fixture
def told(monkeypatch):
    """Poses that the memory of a moving camera gets."""
    found, add = [], MovingMemory.add

    def noted(self, light, belief, pose=None, noise=0.0):
        found.append(Pose.of(pose).matrix)
        return add(self, light, belief, pose, noise)

    monkeypatch.setattr(MovingMemory, "add", noted)
    return found


def assert_steps(told, count):
    """The camera, which looks along x, goes ahead."""
    assert len(told) == count
    np.testing.assert_allclose(told[0][:3, 2], [1, 0, 0], atol=1e-9)
    for index, pose in enumerate(told):
        np.testing.assert_allclose(pose[:3, 3], [0.1 + STEP_M * index, 0, 0.3], atol=1e-6)


@pytest.mark.parametrize("by_odometry", [False, True])
def test_a_bag_tells_the_poses_of_its_frames(scene, tmp_path, capsys, told, by_odometry):
    source = walked(scene, tmp_path / "walk", by_odometry=by_odometry)
    model = ("--bank", scene.bank, "--camera", scene.camera, "--deblur", "none")
    done = call(capsys, "bag", source, "-o", tmp_path / "out", *model, *MOVING)
    assert done.status == 0, done.err
    assert_steps(told[-3:], 3)  # one frame before them prepares the pipeline
    told.clear()
    done = call(
        capsys, "depth", *model[:4], *MOVING, f"bag:{source}#/eye/image_raw", "-o", tmp_path
    )
    assert done.status == 0, done.err
    assert_steps(told, 3)


def test_poses_of_a_bag_can_be_pickled(scene, tmp_path):
    path = walked(scene, tmp_path / "walk")
    poses = BagPoses.of_camera(path, "odom", "/eye/image_raw")
    again = pickle.loads(pickle.dumps(poses))
    np.testing.assert_array_equal(again.at(START_NS).matrix, poses.at(START_NS).matrix)
    assert poses.at(START_NS - 1) is None


@pytest.mark.parametrize(
    ("changes", "fixed", "expected"),
    [
        ({"mounted": False}, "odom", "no transform from camera_optical_frame to odom"),
        ({}, "map", "the bag has base_link, camera_optical_frame, odom: give --fixed-frame"),
    ],
)
def test_frames_that_nothing_connects(scene, tmp_path, changes, fixed, expected):
    with pytest.raises(InputError, match=expected):
        BagPoses.of_camera(walked(scene, tmp_path / "walk", **changes), fixed, "/eye/image_raw")


def test_a_bag_without_poses_is_refused(scene, tmp_path, capsys):
    source = write_bag(tmp_path / "bag", recording(scene, frames=2))
    model = ("--bank", scene.bank, "--camera", scene.camera)
    message = "no poses: expected /tf and /tf_static, or nav_msgs/Odometry"
    refused(call(capsys, "bag", source, "-o", tmp_path / "out", *model, *MOVING), message)
    given = f"bag:{source}#/eye/image_raw"
    refused(call(capsys, "depth", *model, *MOVING, given, "-o", tmp_path), message)


def way(path, count, first=0.0):
    """Write a file of poses, 0.1 s apart."""
    lines = [f"{first + 0.1 * i:.1f} {STEP_M * i} 0 0 0 0 0 1" for i in range(count)]
    path.write_text("# time x y z qx qy qz qw\n\n" + "\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("names", [("a", "b"), ("7.0", "7.1")])
def test_pictures_have_the_poses_of_a_file(scene, tmp_path, capsys, told, names):
    frame = np.load(scene.coded_npy)
    for name in names:
        write_image(tmp_path / "in" / f"{name}.png", frame)
    file = way(tmp_path / "way.txt", 2, first=7.0)
    model = ("--bank", scene.bank, "--camera", scene.camera)
    target = tmp_path / "out"
    command = ("depth", *model, *MOVING, "--poses", file, tmp_path / "in", "-o", target)
    done = call(capsys, *command)
    assert done.status == 0, done.err
    assert [pose[0, 3] for pose in told] == pytest.approx([0, STEP_M])
    way(tmp_path / "way.txt", 1, first=7.0)
    done = call(capsys, *command)
    assert done.status == 1 and "way.txt: " in done.err
    assert ("no pose at 7.1" if "." in names[0] else "is frame 2") in done.err


def test_commands_have_no_gyroscope(scene, tmp_path, capsys):
    gyro = ("--temporal-frames", 4, "--moving-camera", "gyro", "--bank", scene.bank)
    for command in ("bag", "depth"):
        given = (command, scene.coded_npy, "-o", tmp_path / "x.npy", "--camera", scene.camera)
        wrong_usage(call(capsys, *given, *gyro), command, "gyro: only depth_node")


def test_pictures_need_a_file_of_poses(scene, tmp_path, capsys):
    model = ("--bank", scene.bank, "--camera", scene.camera)
    given = scene.coded_npy, "-o", tmp_path / "x.npy"
    refused(call(capsys, "depth", *model, *MOVING, *given), "needs --poses FILE")
    file = way(tmp_path / "way.txt", 2)
    done = call(capsys, "depth", *model, "--poses", file, *given)
    wrong_usage(done, "depth", "--poses", "--moving-camera pose")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "no poses, expected lines of time in s"),
        ("0 1 2 3\n", "line 1: no pose"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 nan\n", "line 2: no pose"),
        ("0 0 0 0 0 0 0 0\n", "line 1: no pose"),
        ("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "line 2: its time is not after the line before"),
        ("time x y z qx qy qz qw\n", "line 1: no pose"),
    ],
)
def test_what_is_no_file_of_poses(tmp_path, content, expected):
    path = tmp_path / "way.txt"
    path.write_text(content)
    with pytest.raises(InputError, match=expected):
        PoseFile(path)
    with pytest.raises(InputError, match="cannot read"):
        PoseFile(tmp_path / "none.txt")
