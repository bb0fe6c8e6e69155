"""A driver that plays a bag publishes what was recorded of the camera."""

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image
from small_camera import HEIGHT, WIDTH
from waiting import wait_until

pytest.importorskip("rosbags")
from bag_scene import CAMERA_INFO, IMAGE, PERIOD_NS, START_NS, camera_info, image, write_bag

from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode
from coded_aperture_ros.ros.messages import stamp_ns


def recorded(folder, coded, roi):
    """Bag of a region of the view, whose driver has another focal length than the camera file."""
    left, top, rows, columns = roi
    messages = []
    for index in range(2):
        time_ns = START_NS + index * PERIOD_NS
        model = camera_info(index, WIDTH, HEIGHT, 410.0, roi)
        pixels = np.rint(65535 * coded[top : top + rows, left : left + columns]).astype(np.uint16)
        messages += [
            ("/camera_info", CAMERA_INFO, time_ns, model),
            ("/image_raw", IMAGE, time_ns + 1, image(pixels, "mono16", index)),
        ]
    return write_bag(folder / "bag", messages)


def test_camera_info_is_the_recorded_one(ros, camera_file, coded, tmp_path):
    roi = (20, 12, 64, 80)
    bag = recorded(tmp_path, coded, roi)
    infos = ros.subscribe("camera_info", CameraInfo)
    frames = ros.subscribe("image_raw", Image)
    given = {"camera_file": str(camera_file), "source": f"bag:{bag}", "encoding": "mono16"}
    ros.make(CameraDriverNode, {**given, "rate_hz": 20.0})
    assert wait_until(lambda: len(infos) > 2 and len(frames) > 2)
    info = infos[0]
    assert (info.k[0], info.d[0]) == (410.0, 0.1)
    assert (info.width, info.height) == (WIDTH, HEIGHT)
    assert (info.roi.x_offset, info.roi.y_offset, info.roi.height, info.roi.width) == roi
    assert (frames[0].height, frames[0].width) == roi[2:]
    assert {stamp_ns(one.header) for one in frames} <= {stamp_ns(one.header) for one in infos}


def test_a_calibration_that_was_asked_for_goes_before_it(ros, camera_file, coded, tmp_path):
    from coded_aperture_ros.optics import Intrinsics

    bag = recorded(tmp_path, coded, (0, 0, HEIGHT, WIDTH))
    Intrinsics.pinhole(444.0, WIDTH, HEIGHT).save(tmp_path / "mine.yaml")
    infos = ros.subscribe("camera_info", CameraInfo)
    given = {"camera_file": str(camera_file), "source": f"bag:{bag}", "rate_hz": 20.0}
    ros.make(CameraDriverNode, {**given, "camera_info_url": f"file://{tmp_path}/mine.yaml"})
    assert wait_until(lambda: infos)
    assert infos[0].k[0] == 444.0
