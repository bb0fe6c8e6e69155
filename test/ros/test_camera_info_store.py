"""The driver's calibration: where it is, and how a calibration program sets it."""

import dataclasses
from pathlib import Path

import pytest
import yaml
from cameras import TINY
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo
from waiting import wait_until

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.share import share_directory
from coded_aperture_ros.optics import Intrinsics, load_intrinsics
from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode
from coded_aperture_ros.ros.camera_info_store import camera_info_path

MEASURED = Intrinsics(64, 48, (121.0, 0.0, 30.0, 0.0, 122.0, 25.0, 0.0, 0.0, 1.0), (0.1,) * 5)


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_HOME", str(tmp_path / "ros"))
    return tmp_path / "ros"


def drive(ros, tmp_path, **parameters):
    camera_file = tmp_path / "camera.yaml"
    camera_file.write_text(yaml.safe_dump(TINY))
    given = {"camera_file": str(camera_file), "rate_hz": 50.0, **parameters}
    return ros.make(CameraDriverNode, given)


def message(**changes):
    info = CameraInfo(width=64, height=48, distortion_model="plumb_bob", d=[0.1] * 5)
    info.k, info.r = list(MEASURED.camera_matrix), [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0]
    info.p = list(MEASURED.projection_matrix)
    for name, value in changes.items():
        setattr(info, name, value)
    return info


def set_info(ros, info, service="set_camera_info"):
    client = ros.probe.create_client(SetCameraInfo, service)
    assert wait_until(client.service_is_ready)
    future = client.call_async(SetCameraInfo.Request(camera_info=info))
    assert wait_until(future.done)
    return future.result()


def test_urls(home):
    assert camera_info_path("file:///a/b%20c.yaml", "eye") == Path("/a/b c.yaml")
    assert camera_info_path("file://${ROS_HOME}/${NAME}.yaml", "eye") == home / "eye.yaml"
    share = camera_info_path("package://coded_aperture_ros/config/x.yaml", "eye")
    assert share == share_directory() / "config" / "x.yaml"


def test_without_ros_home_it_is_in_the_users_home(monkeypatch):
    monkeypatch.delenv("ROS_HOME", raising=False)
    found = camera_info_path("file://${ROS_HOME}/x.yaml", "eye")
    assert found == Path.home() / ".ros" / "x.yaml"


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("file://relative.yaml", "file:///PATH"),
        ("http://x/y.yaml", "file:///PATH"),
        ("/a/b.yaml", "file:///PATH"),
        ("package://only_a_package", "package://PACKAGE/PATH"),
        ("package://no_such_package/x.yaml", "no_such_package"),
        ("file:///${HOSTNAME}.yaml", "HOSTNAME"),
    ],
)
def test_other_urls_are_refused(home, url, says):
    with pytest.raises(InputError, match="camera_info_url") as error:
        camera_info_path(url, "eye")
    assert says in str(error.value)


def test_a_calibration_program_sets_it_and_it_stays(ros, home, tmp_path):
    infos = ros.subscribe("camera_info", CameraInfo)
    node = drive(ros, tmp_path)
    assert wait_until(lambda: infos)
    assert infos[-1].k[0] == pytest.approx(119.4)
    answer = set_info(ros, message())
    assert answer.success, answer.status_message
    assert wait_until(lambda: infos[-1].k[0] == 121.0)
    assert list(infos[-1].d) == [0.1] * 5
    saved = load_intrinsics(home / "camera_info" / "camera.yaml")
    assert saved.camera_matrix == MEASURED.camera_matrix
    ros.remove(node)
    infos.clear()
    drive(ros, tmp_path)
    assert wait_until(lambda: infos)
    assert infos[-1].k[0] == 121.0


def test_what_no_camera_can_be_is_refused_and_the_old_one_stays(ros, home, tmp_path):
    infos = ros.subscribe("camera_info", CameraInfo)
    drive(ros, tmp_path)
    for broken in (
        message(width=0),
        message(k=[0.0] * 9),
        message(k=[float("nan")] * 9),
        message(distortion_model="fisheye of my own"),
    ):
        answer = set_info(ros, broken)
        assert not answer.success
        assert answer.status_message
    assert wait_until(lambda: infos)
    assert infos[-1].k[0] == pytest.approx(119.4)
    assert not home.exists()


def test_a_calibration_of_other_proportions_is_refused(ros, home, tmp_path):
    infos = ros.subscribe("camera_info", CameraInfo)
    drive(ros, tmp_path)
    assert wait_until(lambda: infos)
    answer = set_info(ros, message(height=36))
    assert not answer.success
    assert "64x36" in answer.status_message and "64x48 frames" in answer.status_message
    assert not home.exists()
    count = len(infos)
    assert wait_until(lambda: len(infos) > count + 5)
    assert [info.k[0] for info in infos] == pytest.approx([119.4] * len(infos))
    assert set_info(ros, message(width=128, height=96)).success
    assert wait_until(lambda: infos[-1].k[0] == 60.5)


def test_before_the_first_frame_nobody_knows_whether_a_calibration_fits(ros, home, tmp_path):
    """While nobody listens, there are no frames."""
    node = drive(ros, tmp_path, lazy=True)
    answer = set_info(ros, message(height=36))
    assert answer.success
    assert "not compared with the frames: no frame has come yet" in answer.status_message
    images = ros.subscribe("image_raw", Image)
    assert wait_until(lambda: images)
    assert node.statistics.summary().received
    answer = set_info(ros, message())
    assert answer.success and answer.status_message.endswith("camera.yaml")


def test_frames_of_other_proportions_have_no_camera_info(ros, tmp_path, capfd):
    wide = dataclasses.replace(MEASURED, image_height=36)
    wide.save(tmp_path / "wide.yaml")
    images, infos = ros.subscribe("image_raw", Image), ros.subscribe("camera_info", CameraInfo)
    drive(ros, tmp_path, camera_info_url=f"file://{tmp_path}/wide.yaml")
    assert wait_until(lambda: len(images) > 5)
    assert infos == []
    said = [
        line for line in capfd.readouterr().err.splitlines() if "camera_info not published" in line
    ]
    assert len(said) == 1
    assert "64x36, which does not have the proportions of the 64x48 frames" in said[0]


def test_a_url_that_cannot_be_loaded_ends_the_start(ros, tmp_path):
    with pytest.raises(InputError, match=r"gone\.yaml"):
        drive(ros, tmp_path, camera_info_url=f"file://{tmp_path}/gone.yaml")


def test_a_folder_that_cannot_be_written_is_told(ros, home, tmp_path):
    home.write_text("no folder")
    drive(ros, tmp_path)
    answer = set_info(ros, message())
    assert not answer.success
    assert "cannot write" in answer.status_message


def test_two_cameras_have_calibrations_of_their_own(ros, home, tmp_path):
    camera_file = tmp_path / "camera.yaml"
    camera_file.write_text(yaml.safe_dump(TINY))
    for name in ("left", "right"):
        ros.make(CameraDriverNode, {"camera_file": str(camera_file)}, namespace=f"/robot/{name}")
    assert set_info(ros, message(), "/robot/left/set_camera_info").success
    assert [path.name for path in (home / "camera_info").iterdir()] == ["left.yaml"]
