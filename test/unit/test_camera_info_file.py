"""Camera calibrations in the YAML files of the ROS tools, and camera files that name one."""

import dataclasses

import pytest
import yaml

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import View
from coded_aperture_ros.optics import Intrinsics, load_camera, load_intrinsics

# As camera_calibration writes it.
FROM_ROS = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0.0, 0.0, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [0.999978, 0.002789, -0.006046, -0.002816, 0.999986, -0.004401, 0.006034, 0.004417, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.653800, 0.0, 322.797939, 0.0, 0.0, 393.653800, 241.090902, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
CAMERA = {
    "focal_length_px": 438.0,
    "focus_distance_m": 1.0,
    "image_width": 640,
    "image_height": 480,
    "mask": {"name": "levin"},
    "mask_extent_mm": 20.0,
}


def content(**changes):
    values = {**yaml.safe_load(FROM_ROS), **changes}
    return {key: value for key, value in values.items() if value is not None}


def matrix(rows, cols, data):
    return {"rows": rows, "cols": cols, "data": data}


def written(folder, values, name="info.yaml"):
    path = folder / name
    path.write_text(values if isinstance(values, str) else yaml.safe_dump(values))
    return path


def test_a_region_may_have_its_centre_anywhere(tmp_path):
    info = load_intrinsics(written(tmp_path, FROM_ROS))
    centred = dataclasses.replace(info, camera_matrix=(400.0, 0, 320.0, 0, 400.0, 240.0, 0, 0, 1.0))
    at_0 = centred.for_view(View(100, 80, 640, 480, 320, 240))
    assert (at_0.camera_matrix[2], at_0.camera_matrix[5]) == (0, 0)
    beside = centred.for_view(View(8, 8, 640, 480, 632, 472))
    assert beside.camera_matrix[2] == -312


def test_a_file_of_the_ros_tool_is_read(tmp_path):
    info = load_intrinsics(written(tmp_path, FROM_ROS))
    assert (info.image_width, info.image_height, info.camera_name) == (640, 480, "narrow_stereo")
    assert info.camera_matrix[0] == 438.783367
    assert info.camera_matrix[5] == 243.738352
    assert info.distortion_coefficients == (-0.361976, 0.110510, 0.001014, 0.000505, 0)
    assert info.rectification_matrix[1] == 0.002789
    assert info.projection_matrix[6] == 241.090902


def test_what_is_saved_is_read_again(tmp_path):
    info = load_intrinsics(written(tmp_path, FROM_ROS))
    info.save(tmp_path / "new folder" / "again.yaml")
    assert load_intrinsics(tmp_path / "new folder" / "again.yaml") == info
    stored = yaml.safe_load((tmp_path / "new folder" / "again.yaml").read_text())
    assert list(stored) == list(yaml.safe_load(FROM_ROS))
    assert stored["projection_matrix"]["rows"] == 3
    pinhole = Intrinsics.pinhole(400.0, 320, 240)
    pinhole.save(tmp_path / "pinhole.yaml")
    assert load_intrinsics(tmp_path / "pinhole.yaml") == pinhole


def test_the_pinhole_has_its_centre_in_the_middle():
    info = Intrinsics.pinhole(400.0, 320, 240)
    assert info.camera_matrix == (400, 0, 159.5, 0, 400, 119.5, 0, 0, 1)
    assert info.projection_matrix == (400, 0, 159.5, 0, 0, 400, 119.5, 0, 0, 0, 1, 0)


def test_the_scaled_model_sees_the_same_rays():
    info = Intrinsics.pinhole(400.0, 320, 240).resized(160, 120)
    assert info == Intrinsics.pinhole(200.0, 160, 120)


def test_only_what_is_needed_has_to_be_there(tmp_path):
    needed = content(
        rectification_matrix=None, projection_matrix=None, camera_name=None, distortion_model=None
    )
    info = load_intrinsics(written(tmp_path, needed))
    assert info.rectification_matrix == (1, 0, 0, 0, 1, 0, 0, 0, 1)
    assert info.projection_matrix[:4] == (*info.camera_matrix[:3], 0)


@pytest.mark.parametrize(
    ("changes", "phrase"),
    [
        ({"image_width": None}, "missing image_width"),
        ({"image_height": 0}, "image_height: expected a whole number of pixels, got 0"),
        ({"image_width": "640"}, "image_width: expected a whole number"),
        ({"camera_matrix": None}, "missing camera_matrix"),
        ({"camera_matrix": [1, 2]}, "camera_matrix: expected rows, cols and data"),
        ({"camera_matrix": {"rows": 3, "cols": 3}}, "camera_matrix: missing data"),
        ({"camera_matrix": matrix(3, 4, [0] * 12)}, "camera_matrix: expected 3 rows and 3 cols"),
        ({"camera_matrix": matrix(3, 3, [1] * 8)}, "camera_matrix: data: expected 3 x 3 numbers"),
        ({"camera_matrix": matrix(3, 3, ["a"] * 9)}, "camera_matrix: data"),
        ({"camera_matrix": matrix(3, 3, [0] * 9)}, "camera_matrix: the focal lengths"),
        (
            {"camera_matrix": matrix(3, 3, [float("nan")] * 9)},
            "camera_matrix: expected 9 finite numbers",
        ),
        ({"distortion_coefficients": None}, "missing distortion_coefficients"),
        ({"distortion_coefficients": matrix(1, 3, [0] * 3)}, "distortion_coefficients: plumb_bob"),
        (
            {"distortion_coefficients": matrix(2, 5, [0] * 10)},
            "distortion_coefficients: expected 1",
        ),
        (
            {"distortion_model": "fov", "distortion_coefficients": matrix(1, 1, [0.9])},
            "distortion_model: 'fov' is not known",
        ),
        ({"projection_matrix": matrix(3, 3, [1] * 9)}, "projection_matrix: expected 3 rows and 4"),
    ],
)
def test_a_bad_file_is_refused_by_name_and_key(tmp_path, changes, phrase):
    path = written(tmp_path, content(**changes))
    with pytest.raises(InputError) as caught:
        load_intrinsics(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert phrase in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "phrase"), [("a: [", "not valid YAML"), ("", "expected the keys"), (None, "No such")]
)
def test_unreadable_files_are_refused(tmp_path, text, phrase):
    path = tmp_path / "info.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=f"info.yaml.*{phrase}"):
        load_intrinsics(path)


# ---- camera files ----


def test_a_camera_file_may_name_a_calibration(tmp_path):
    written(tmp_path, FROM_ROS)
    camera = load_camera(written(tmp_path, {**CAMERA, "camera_info": "info.yaml"}, "camera.yaml"))
    assert camera.intrinsics == load_intrinsics(tmp_path / "info.yaml")
    plain = load_camera(written(tmp_path, CAMERA, "plain.yaml"))
    assert plain.intrinsics == Intrinsics.pinhole(438.0, 640, 480)
    assert camera.blur_size_px(2.0) == plain.blur_size_px(2.0)
    half = camera.scaled(0.5)
    assert half.intrinsics == camera.intrinsics.resized(320, 240)
    assert dataclasses.replace(half, measured=None) == plain.scaled(0.5)


@pytest.mark.parametrize(
    ("entry", "phrase"),
    [
        (3, "camera_info: expected the name of a file, got 3"),
        ("none.yaml", "none.yaml: No such file"),
        ("small.yaml", "camera_info: for images of 320x240, this camera's have 640x480"),
    ],
)
def test_a_bad_calibration_of_a_camera_file(tmp_path, entry, phrase):
    Intrinsics.pinhole(400.0, 320, 240).save(tmp_path / "small.yaml")
    path = written(tmp_path, {**CAMERA, "camera_info": entry}, "camera.yaml")
    with pytest.raises(InputError) as caught:
        load_camera(path)
    assert "camera.yaml" in str(caught.value)
    assert phrase in str(caught.value)


def test_the_message_has_what_the_file_says(tmp_path):
    pytest.importorskip("rclpy")
    from std_msgs.msg import Header

    from coded_aperture_ros.ros.messages import camera_info_from_camera

    written(tmp_path, FROM_ROS)
    camera = load_camera(written(tmp_path, {**CAMERA, "camera_info": "info.yaml"}, "camera.yaml"))
    info = camera_info_from_camera(camera, Header(frame_id="eye"))
    assert (info.width, info.height, info.header.frame_id) == (640, 480, "eye")
    assert tuple(info.k) == camera.intrinsics.camera_matrix
    assert tuple(info.d) == camera.intrinsics.distortion_coefficients
    assert tuple(info.r) == camera.intrinsics.rectification_matrix
    assert tuple(info.p) == camera.intrinsics.projection_matrix
    assert info.distortion_model == "plumb_bob"
