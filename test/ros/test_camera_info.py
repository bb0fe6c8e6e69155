"""Which camera_info a frame is worked on with."""

import numpy as np
import pytest
from node_chains import Chain, DeblurChain, mono8, stamped, wall
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, RegionOfInterest
from small_camera import CAMERA, HEIGHT, WIDTH
from waiting import wait_until

from coded_aperture_ros.ros import depth_node
from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode
from coded_aperture_ros.ros.messages import stamp_ns


def told(focal_length_px, header=None, **changes):
    """Return what a driver says of the camera of a frame."""
    info = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model="plumb_bob", d=[0.0] * 5)
    info.k = [focal_length_px, 0.0, 63.5, 0.0, focal_length_px, 47.5, 0.0, 0.0, 1.0]
    info.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    if header is not None:
        info.header = header
    for name, value in changes.items():
        setattr(info, name, value)
    return info


def focal_length(chain, frame):
    """Return the focal length that is published with the depth of a frame, px."""
    return chain.result(frame, "depth/camera_info").k[0]


def test_depth_has_the_camera_info_of_its_frame(ros, model, coded):
    chain = Chain(ros, model)
    first, second = mono8(coded), mono8(coded)
    chain.tell(told(410.0, first.header), told(430.0, second.header))
    assert focal_length(chain, first) == 410.0
    assert focal_length(chain, second) == 430.0
    assert focal_length(chain, mono8(coded)) == 430.0  # the newest, where its own has not come
    assert chain.rejected == {}


def test_all_in_focus_frames_have_the_camera_info_of_their_frame(ros, model, coded):
    chain = DeblurChain(ros, model)
    infos = ros.publisher("camera_info", CameraInfo)
    assert wait_until(infos.get_subscription_count)
    first, second = mono8(coded), mono8(coded)
    for focal_length_px, frame in ((410.0, first), (430.0, second)):
        ros.hand_over(infos, told(focal_length_px, frame.header))
    chain.images.publish(first)
    chain.depths.publish(wall(first.header))
    assert wait_until(lambda: chain.infos)
    assert chain.infos[0].k[0] == 410.0


def test_a_camera_info_that_comes_during_a_frame_is_for_the_next(ros, model, coded, monkeypatch):
    chain = Chain(ros, model)
    clouds = ros.subscribe("depth/points", PointCloud2)
    assert wait_until(lambda: chain.node.count_subscribers("depth/points"))
    limit_depth, meanwhile = depth_node.limit_depth, [told(800.0, width=2 * WIDTH)]

    def changing(*arguments):
        chain.tell(*meanwhile)
        meanwhile.clear()
        return limit_depth(*arguments)

    monkeypatch.setattr(depth_node, "limit_depth", changing)
    chain.tell(told(410.0))
    assert focal_length(chain, mono8(coded)) == 410.0
    assert chain.rejected == {}
    assert wait_until(lambda: clouds)
    points = np.frombuffer(clouds[0].data, np.float32).reshape(HEIGHT, WIDTH, 6)
    row, column = np.argwhere(np.isfinite(points[..., 2]))[0]
    x, _, z = points[row, column, :3]
    assert 410.0 * x / z + 63.5 == pytest.approx(column, abs=0.01)
    chain.send(mono8(coded))
    assert wait_until(lambda: chain.rejected == {"camera_info": 1})


def test_the_stamps_of_a_time_that_was_set_back_do_not_count(ros, model, coded):
    chain = Chain(ros, model)
    header = stamped()
    chain.tell(told(410.0, header), told(430.0, stamped()))
    chain.node.restart()
    assert focal_length(chain, mono8(coded, header)) == 430.0


def test_the_driver_sends_camera_info_before_its_frame(ros, camera_file):
    arrived = []
    for topic, kind in (("camera_info", CameraInfo), ("image_raw", Image)):
        ros.probe.create_subscription(kind, topic, arrived.append, 10)
    ros.make(CameraDriverNode, {"camera_file": str(camera_file), "rate_hz": 5.0})
    assert wait_until(lambda: len(arrived) > 8)
    kinds = {}
    for message in arrived:
        kinds.setdefault(stamp_ns(message.header), type(message))
    assert list(kinds.values())[1:4] == [CameraInfo] * 3


NAN = float("nan")
BROKEN = {
    "coefficients": ({"d": [0.1] * 3}, "plumb_bob has 4 or 5 or 8 or 12 or 14 numbers, got 3"),
    "nan in D": (
        {"d": [0.1, NAN, 0.0, 0.0, 0.0]},
        "distortion_coefficients: expected finite numbers",
    ),
    "nan in K": (
        {"k": [400.0, 0.0, NAN, 0.0, 400.0, 47.5, 0.0, 0.0, 1.0]},
        "camera_matrix: expected 9",
    ),
    "nan focal length": (
        {"k": [NAN, 0.0, 63.5, 0.0, 400.0, 47.5, 0.0, 0.0, 1.0]},
        "camera_matrix: expected 9 finite numbers",
    ),
    "negative": (
        {"k": [-400.0, 0.0, 63.5, 0.0, 400.0, 47.5, 0.0, 0.0, 1.0]},
        "focal lengths have to be more than 0 px",
    ),
    "nan in P": ({"p": [400.0, 0.0, NAN] + [0.0] * 9}, "projection_matrix: expected 12"),
    "zeros in R": ({"r": [0.0] * 9}, "rectification_matrix: it is no rotation"),
    "centre": ({"k": [400.0, 0.0, 0.0, 0.0, 400.0, 47.5, 0.0, 0.0, 1.0]}, "cx of 0 in 128 px"),
    "size": ({"width": 0}, "width or height is 0"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_camera_info_of_no_camera_is_told_and_the_one_before_holds(ros, model, coded, fault):
    changes, reason = BROKEN[fault]
    chain = Chain(ros, model)
    clouds = ros.subscribe("depth/points", PointCloud2)
    assert wait_until(lambda: chain.node.count_subscribers("depth/points"))
    chain.tell(told(430.0, **changes))
    assert focal_length(chain, mono8(coded)) == CAMERA["focal_length_px"]
    chain.tell(told(410.0), told(430.0, **changes))
    assert focal_length(chain, mono8(coded)) == 410.0
    assert wait_until(lambda: len(clouds) == 2)
    summary = chain.node.statistics.summary()
    assert (summary.processed, summary.rejected) == (2, {"camera_info": 2})
    assert reason in summary.last_error and "\n" not in summary.last_error


def test_many_of_them_are_one_line(ros, model, capfd):
    chain = Chain(ros, model)
    chain.tell(*(told(410.0, **BROKEN["coefficients"][0]) for _ in range(3)))
    assert wait_until(lambda: chain.rejected == {"camera_info": 3})
    lines = [line for line in capfd.readouterr().err.splitlines() if "camera_info" in line]
    assert len(lines) == 1
    assert "calibrate again" in lines[0]


@pytest.mark.parametrize("roi", [(24, 0, 0, 0), (0, 16, 0, 0), (24, 16, WIDTH, 0)])
def test_a_region_without_a_size_is_all_of_the_view(ros, model, coded, roi):
    x, y, width, height = roi
    region = RegionOfInterest(x_offset=x, y_offset=y, width=width, height=height)
    whole = {"width": WIDTH + x} if width else {}
    chain = Chain(ros, model)
    chain.tell(told(410.0, roi=region, **whole))
    assert focal_length(chain, mono8(coded)) == 410.0
    assert chain.rejected == {}


@pytest.mark.parametrize(("model_name", "count"), [("radtan", 4), ("plumb_bob", 8), ("", 5)])
def test_distortion_may_have_any_name_that_opencv_can_undo(ros, model, coded, model_name, count):
    chain = Chain(ros, model)
    chain.tell(told(410.0, distortion_model=model_name, d=[0.01] + [0.0] * (count - 1)))
    assert focal_length(chain, mono8(coded)) == 410.0
    assert chain.rejected == {}


def test_a_lens_without_distortion_may_call_its_model_anything(ros, model, coded):
    chain = Chain(ros, model)
    chain.tell(told(410.0, distortion_model="none", d=[0.0] * 3))
    assert focal_length(chain, mono8(coded)) == 410.0
    chain.tell(told(0.0))  # not calibrated: says nothing, and is no fault
    assert focal_length(chain, mono8(coded)) == 410.0
    assert chain.rejected == {}
