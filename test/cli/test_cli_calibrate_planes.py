"""The command `calibrate planes`: from files, and from a topic over real DDS."""

import io
import json
import threading

import numpy as np
import pytest
import yaml
from cli_scene import call, everything, refused, wrong_usage
from planes_scene import DEPTHS_M, FOCUS_M, SLOPE_PX_M, WINDOW, plane

from coded_aperture_ros.calibration.planes.folder import add_plane
from coded_aperture_ros.frames import SRGB
from coded_aperture_ros.io import read_image, write_image
from coded_aperture_ros.likelihood.bank import load_bank
from coded_aperture_ros.optics import load_camera

SMALL = ("--window-px", WINDOW, "--rank", 16, "--level-count", 7)
SIZE = 96


@pytest.fixture
def quick(monkeypatch):
    """Make the search short: what is around it is tested here."""
    for name, value in (("_FIRST_STEPS", 8), ("_COARSE_STEPS", 8), ("_FINE_STEPS", 25)):
        monkeypatch.setattr(f"coded_aperture_ros.calibration.planes.search.{name}", value)
    monkeypatch.setattr("coded_aperture_ros.calibration.planes.search._NEAREST_TO_FOCUS", (0.15,))


@pytest.fixture(scope="module")
def pictures():
    return [plane(depth, seed, size=SIZE) for seed, depth in enumerate(DEPTHS_M)]


@pytest.fixture
def folder(tmp_path, pictures):
    path = tmp_path / "planes"
    for image, depth in zip(pictures, DEPTHS_M, strict=True):
        add_plane(path, image, round(float(depth), 4))
    return path


def camera_file(folder, **changes):
    values = {
        "focal_length_px": 400.0,
        "focus_distance_m": 1.1,
        "image_width": SIZE,
        "image_height": SIZE,
        "mask": {"name": "levin"},
        "mask_extent_mm": 30.0,
        **changes,
    }
    path = folder / "camera.yaml"
    path.write_text(yaml.safe_dump({name: value for name, value in values.items() if value}))
    return path


def test_a_folder_with_a_camera_file(tmp_path, folder, capsys, quick):
    output = tmp_path / "report"
    kept = {"noise": 0.001, "wavelength_nm": 600.0, "focal_length_mm": 50.0}
    kept["pixel_pitch_um"] = 50 * 1100 / 1050 / 0.4
    path = camera_file(tmp_path, focal_length_px=None, **kept)
    arguments = ("calibrate", "planes", folder, "--camera", path, *SMALL)
    arguments += ("--output", output, "-o", tmp_path / "bank.npz")
    result = call(capsys, *arguments, "--json")
    assert (result.status, result.err) == (0, "")
    summary = json.loads(result.out)
    assert summary == json.loads((output / "calibrate_planes.json").read_text())
    assert summary["focus_distance_m"] == pytest.approx(FOCUS_M, rel=0.06)
    assert summary["slope_px_m"] == pytest.approx(SLOPE_PX_M, rel=0.1)
    assert (summary["mask"], summary["mask_is_known"], summary["side"]) == ("levin", True, "far")
    assert [one["depth_m"] for one in summary["planes"]] == pytest.approx(DEPTHS_M, abs=1e-4)
    assert summary["left_out_error"] < 0.1
    bank = load_bank(tmp_path / "bank.npz")
    assert (bank.levels, bank.window_px) == (7, WINDOW)
    found = load_camera(output / "camera.yaml")
    assert found.focus_distance_m == pytest.approx(summary["focus_distance_m"])
    # What was not measured stays; the image distance follows the focus.
    assert {
        name: yaml.safe_load((output / "camera.yaml").read_text())[name] for name in kept
    } == kept
    assert found.mask_extent_mm == pytest.approx(
        summary["slope_px_m"] / found.focal_length_px * 1e3, rel=1e-3
    )
    assert found.focal_length_px == pytest.approx(400, rel=0.01)
    assert found.blur_size_px(DEPTHS_M) == pytest.approx(
        bank.pattern.blur_size_px(DEPTHS_M), abs=0.01
    )


def test_pictures_with_depths(tmp_path, folder, capsys, quick):
    files = sorted(folder.glob("*.png"))
    depths = ",".join(f"{depth:.4f}" for depth in DEPTHS_M)
    arguments = ("calibrate", "planes", *files, "--depths", depths, *SMALL)
    result = call(capsys, *arguments, "-o", tmp_path / "bank.npz")
    assert (result.status, result.err) == (0, "")
    assert "expected depth error" in result.out
    assert "8 planes" in result.out
    assert load_bank(tmp_path / "bank.npz").pattern is not None


def changed(folder, index, image=None, **entry):
    """Replace one picture, or change one entry of the list."""
    entries = json.loads((folder / "planes.json").read_text())
    if image is not None:
        write_image(folder / entries[index]["file"], image)
    entries[index] |= entry
    (folder / "planes.json").write_text(json.dumps(entries))


@pytest.mark.parametrize(
    ("index", "change", "phrases"),
    [
        (3, {"image": np.full((SIZE, SIZE), 0.4)}, ["m.png: contrast 0 is not above", "texture"]),
        (3, {"image": np.ones((SIZE, SIZE))}, ["100% of the pixels are saturated", "shorter"]),
        (3, {"image": np.full((SIZE, 64), 0.4)}, ["64x96 px", "has 96x96 px"]),
        (3, {"depth_m": 0.1}, ["depth_m 0.1 is out of order"]),
        (3, {"file": "none.png"}, ["cannot read", "none.png"]),
    ],
)
def test_pictures_that_cannot_be_used(tmp_path, folder, capsys, index, change, phrases):
    changed(folder, index, **change)
    before = everything(tmp_path)
    output = ("--output", tmp_path / "report", "-o", tmp_path / "bank.npz")
    refused(call(capsys, "calibrate", "planes", folder, *SMALL, *output), *phrases)
    assert everything(tmp_path) == before


def test_swapped_depths_leave_nothing_behind(tmp_path, folder, capsys, quick):
    entries = json.loads((folder / "planes.json").read_text())
    entries[1]["file"], entries[6]["file"] = entries[6]["file"], entries[1]["file"]
    (folder / "planes.json").write_text(json.dumps(entries))
    before = everything(tmp_path)
    output = ("--output", tmp_path / "report", "-o", tmp_path / "bank.npz")
    result = call(capsys, "calibrate", "planes", folder, *SMALL, *output)
    refused(result, entries[1]["file"], entries[6]["file"])
    assert everything(tmp_path) == before


def test_too_few_planes(tmp_path, folder, capsys):
    files = sorted(folder.glob("*.png"))[:3]
    arguments = ("--depths", "1,2,3", "-o", tmp_path / "bank.npz")
    refused(call(capsys, "calibrate", "planes", *files, *arguments), "3 planes are too few")


def test_a_camera_of_another_size(tmp_path, folder, capsys):
    camera = camera_file(tmp_path, image_width=640)
    arguments = ("--camera", camera, "-o", tmp_path / "bank.npz")
    refused(call(capsys, "calibrate", "planes", folder, *arguments), camera, "640x96", "96x96")


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        ((), "the following arguments are required"),
        (("planes",), "required: -o or --topic (where the bank goes)"),
        (("planes", "--depth", 1, "-o", "b.npz"), "--depth: only with --topic"),
        (("planes", "--topic", "image_raw", "--depth", -1), "--depth: -1.0 is out of range"),
        (("planes", "--topic", "image_raw"), "--topic: without a terminal needs --depth"),
        (("planes", "--topic", "t", "--depth", 1, "--frames", 0), "--frames: 0 is out of range"),
        (("a", "b", "--topic", "t", "--depth", 1), "--topic: needs one folder"),
        (("planes", "--depths", "1,x", "-o", "b.npz"), "--depths: expected numbers"),
        (("planes", "--level-count", 1, "-o", "b.npz"), "--level-count: 1 is out of range"),
    ],
)
def test_wrong_usage(capsys, monkeypatch, arguments, phrase):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    wrong_usage(call(capsys, "calibrate", "planes", *arguments), "calibrate planes", phrase)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        (("--camera", "camera.yaml"), "--camera"),
        (("--depth-range", 1, 2), "--depth-range"),
        (("--json",), "--json"),
        (("--output", "report"), "--output"),
    ],
)
def test_options_before_the_action_are_not_lost(capsys, options, name):
    result = call(capsys, "calibrate", *options, "planes", "folder", "-o", "bank.npz")
    wrong_usage(result, "calibrate", f"{name}: goes after the word planes")


def test_the_design_needs_no_action_word(tmp_path, capsys):
    camera = camera_file(tmp_path, focus_distance_m=1.0)
    arguments = ("--camera", camera, "--depth-range", 1.2, 3, "--json")
    result = call(capsys, "calibrate", *arguments)
    assert result.status == 0
    assert json.loads(result.out)["levels"] > 1


# ---- from a topic ----


@pytest.fixture
def camera(pictures):
    """Publish frames of a plane, each with its own noise, until the test ends."""
    pytest.importorskip("rclpy")
    from rclpy.qos import qos_profile_sensor_data
    from ros_helpers import Ros
    from sensor_msgs.msg import Image
    from std_msgs.msg import Header

    from coded_aperture_ros.io.messages import pixels_from_frame
    from coded_aperture_ros.ros.messages import image_from_array

    ros = Ros()
    publisher = ros.publisher("image_raw", Image, qos_profile_sensor_data)
    shown = {"picture": pictures[0], "encoding": "mono16"}
    stop = threading.Event()
    random = np.random.default_rng(0)

    def publish():
        while not stop.wait(0.02):
            frame = shown["picture"] + random.normal(0, 0.01, (SIZE, SIZE)).astype(np.float32)
            pixels = pixels_from_frame(frame, shown["encoding"], SRGB)
            publisher.publish(image_from_array(pixels, shown["encoding"], Header()))

    thread = threading.Thread(target=publish)
    thread.start()
    yield shown
    stop.set()
    thread.join()
    ros.close()


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_planes_from_a_topic_one_by_one(tmp_path, capsys, camera, pictures):
    folder = tmp_path / "planes"
    for index in (2, 0):
        camera["picture"] = pictures[index]
        arguments = ("--topic", "image_raw", "--depth", f"{DEPTHS_M[index]:.4f}", "--frames", 6)
        result = call(capsys, "calibrate", "planes", folder, *arguments)
        assert (result.status, result.out) == (0, "")
        assert "mean of 6 frames" in result.err
    assert "has planes at" in result.err
    entries = json.loads((folder / "planes.json").read_text())
    assert [entry["depth_m"] for entry in entries] == pytest.approx(DEPTHS_M[[0, 2]], abs=1e-4)
    assert [entry["frames"] for entry in entries] == [6, 6]
    for entry, index in zip(entries, (0, 2), strict=True):
        error = read_image(folder / entry["file"]) - pictures[index]
        assert 0.003 < np.std(error) < 0.006  # 0.01 / sqrt(6)


def test_planes_from_a_topic_as_asked(tmp_path, capsys, camera, pictures, monkeypatch):
    folder = tmp_path / "planes"
    monkeypatch.setattr("sys.stdin", Terminal("1.25\nfar\n2\n\n3\n"))
    result = call(capsys, "calibrate", "planes", folder, "--topic", "image_raw", "--frames", 2)
    assert (result.status, result.out) == (0, "")
    assert "far: not a distance" in result.err
    entries = json.loads((folder / "planes.json").read_text())
    assert [entry["depth_m"] for entry in entries] == [1.25, 2]


def test_planes_from_a_topic_with_a_tone_curve(tmp_path, capsys, camera, pictures):
    camera["encoding"] = "mono8"
    arguments = ("--topic", "image_raw", "--depth", 2, "--gamma", "srgb", "--frames", 4)
    assert call(capsys, "calibrate", "planes", tmp_path / "planes", *arguments).status == 0
    (taken,) = (tmp_path / "planes").glob("*.png")
    assert np.median(read_image(taken) / pictures[0]) == pytest.approx(1, abs=0.03)


def test_a_topic_without_frames(tmp_path, capsys):
    pytest.importorskip("rclpy")
    arguments = ("--topic", "nothing_here", "--depth", 1, "--timeout", 0.3)
    result = call(capsys, "calibrate", "planes", tmp_path / "planes", *arguments)
    refused(result, "topic nothing_here: 0 of 8 frames came within 0.3 s", "ros2 topic hz")
    assert everything(tmp_path) == {}
