"""camera_driver_node over real DDS, from every kind of source."""

import threading
import time
from itertools import pairwise

import cv2
import numpy as np
import pytest
import yaml
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from tf2_stand_in import stand_in
from waiting import scaled, wait_until

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.messages import array_from_compressed, array_from_image
from coded_aperture_ros.optics import load_camera
from coded_aperture_ros.optics.camera_file import camera_from_mapping
from coded_aperture_ros.ros.camera_driver_node import CameraDriverNode
from coded_aperture_ros.ros.messages import stamp_ns
from coded_aperture_ros.simulation import SensorModel
from coded_aperture_ros.sources import (
    DeviceSource,
    PictureSource,
    SimulatorSource,
    check_source,
    open_source,
)
from coded_aperture_ros.sources.device import automatic_controls

WIDTH, HEIGHT = 64, 48
COMPRESSED = "image_raw.compressed"
CAMERA = {
    "focal_length_px": 119.4,
    "focus_distance_m": 1.9,
    "image_width": WIDTH,
    "image_height": HEIGHT,
    "mask": {"name": "levin"},
    "mask_extent_mm": 52.0,
}


@pytest.fixture(scope="module")
def camera_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("camera") / "camera.yaml"
    path.write_text(yaml.safe_dump(CAMERA))
    return path


@pytest.fixture(scope="module")
def pictures():
    """Return three different colour pictures [row, column, RGB]."""
    random = np.random.default_rng(0)
    return random.integers(0, 256, (3, HEIGHT, WIDTH, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, pictures):
    path = tmp_path_factory.mktemp("pictures")
    for index, picture in enumerate(pictures):
        cv2.imwrite(str(path / f"{index}.png"), picture[:, :, ::-1])
    return path


def drive(ros, camera_file, source, **parameters):
    given = {"camera_file": str(camera_file), "source": str(source), "rate_hz": 50.0}
    return ros.make(CameraDriverNode, {**given, **parameters})


def test_the_simulator_publishes_frames_and_the_truth(ros, camera_file):
    images = ros.subscribe("image_raw", Image)
    infos = ros.subscribe("camera_info", CameraInfo)
    depths = ros.subscribe("ground_truth/depth", Image)
    sharp = ros.subscribe("ground_truth/image", Image)
    true_infos = ros.subscribe("ground_truth/camera_info", CameraInfo)
    drive(ros, camera_file, "simulator", rate_hz=20.0, frame_id="front_optical_frame")
    streams = (images, infos, depths, sharp, true_infos)
    assert wait_until(lambda: min(map(len, streams)) >= 10)
    stamps = [stamps_of(stream) for stream in streams]
    assert len(set.intersection(*stamps)) >= 8  # the very same stamps on every topic
    now = ros.probe.get_clock().now().nanoseconds
    assert 0 < now - stamp_ns(images[-1].header) < 2_000_000_000
    assert {message.header.frame_id for stream in streams for message in stream} == {
        "front_optical_frame"
    }
    assert (images[0].encoding, images[0].width, images[0].height) == ("bgr8", WIDTH, HEIGHT)
    assert depths[0].encoding == "32FC1"
    depth = array_from_image(depths[0])
    assert depth.shape == (HEIGHT, WIDTH)
    assert 1.11 * 1.9 < depth.min() < depth.max() < 2.68 * 1.9
    assert infos[0].k[0] == pytest.approx(CAMERA["focal_length_px"])
    assert (infos[0].k[2], infos[0].k[5]) == ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)


def test_the_rate_is_kept(ros, camera_file, folder):
    images = ros.subscribe("image_raw", Image)
    drive(ros, camera_file, folder, rate_hz=20.0)
    assert wait_until(lambda: images)
    before, began = len(images), time.monotonic()
    time.sleep(2.0)
    rate_hz = (len(images) - before) / (time.monotonic() - began)
    assert 10 / scaled(1) <= rate_hz <= 21


def test_a_folder_is_published_once_in_order(ros, camera_file, folder, pictures):
    images = ros.subscribe("image_raw", Image, 50)
    node = drive(ros, camera_file, folder, loop=False, lazy=True)
    assert wait_until(lambda: len(images) == 3)
    for message, picture in zip(images, pictures, strict=True):
        np.testing.assert_array_equal(array_from_image(message), picture)
    time.sleep(0.3)
    assert len(images) == 3
    assert node.context.ok()


def test_a_broken_picture_does_not_hide_those_after_it(ros, camera_file, tmp_path):
    for value in (10, 20, 30):
        cv2.imwrite(str(tmp_path / f"{value}.png"), np.full((HEIGHT, WIDTH), value, np.uint8))
    (tmp_path / "20.png").write_bytes(b"not a picture")
    images = ros.subscribe("image_raw", Image)
    parameters = {"camera_file": str(camera_file), "encoding": "mono8", "loop": False}
    ros.make(CameraDriverNode, {**parameters, "source": str(tmp_path), "rate_hz": 50.0})
    assert wait_until(lambda: len(images) == 2)
    assert [image.data[0] for image in images] == [10, 30]


def test_nothing_is_read_before_someone_subscribes(ros, camera_file, folder, pictures):
    drive(ros, camera_file, folder, loop=False, rate_hz=100.0)
    time.sleep(0.5)
    images = ros.subscribe("image_raw", Image, 50)
    assert wait_until(lambda: len(images) == 3)
    np.testing.assert_array_equal(array_from_image(images[0]), pictures[0])


def test_a_folder_can_be_looped(ros, camera_file, folder):
    images = ros.subscribe("image_raw", Image, 50)
    drive(ros, camera_file, folder, loop=True)
    assert wait_until(lambda: len(images) > 10)


@pytest.mark.parametrize(
    ("encoding", "dtype", "channels"),
    [("mono8", "u1", 1), ("rgb8", "u1", 3), ("bgr8", "u1", 3), ("mono16", "u2", 1)],
)
def test_encodings(ros, camera_file, folder, pictures, encoding, dtype, channels):
    images = ros.subscribe("image_raw", Image)
    drive(ros, camera_file, folder, encoding=encoding, loop=False)
    assert wait_until(lambda: images)
    pixels = array_from_image(images[0])
    assert (images[0].encoding, pixels.dtype) == (encoding, np.dtype(dtype))
    if channels == 3:
        np.testing.assert_array_equal(pixels, pictures[0])
    else:
        grey = pixels / np.iinfo(pixels.dtype).max
        expected = pictures[0] @ [0.2126, 0.7152, 0.0722] / 255
        np.testing.assert_allclose(grey, expected, atol=0.003)


def write_video(path, frames=5):
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (WIDTH, HEIGHT))
    if not video.isOpened():
        pytest.skip("this OpenCV cannot write videos")
    for index in range(frames):
        video.write(np.full((HEIGHT, WIDTH, 3), 40 * index, np.uint8))
    video.release()


@pytest.mark.parametrize(
    ("parameters", "form", "kept"),
    [
        ({"encoding": "bgr8"}, "bgr8; png compressed bgr8", True),
        ({"encoding": "mono16"}, "mono16; png compressed mono16", True),
        ({"encoding": "mono8", f"{COMPRESSED}.format": "jpeg"}, "mono8; jpeg compressed ", False),
        # JPEG would mix the colours of a mosaic, and has no 16 bits.
        ({"encoding": "bayer_rggb8", f"{COMPRESSED}.format": "jpeg"}, "bayer_rggb8; png", True),
        ({"encoding": "mono16", f"{COMPRESSED}.format": "jpeg"}, "mono16; png", True),
    ],
)
def test_frames_are_compressed_for_those_who_ask(ros, camera_file, folder, parameters, form, kept):
    node = drive(ros, camera_file, folder, **parameters)
    raw = ros.subscribe("image_raw", Image, 50)
    assert wait_until(lambda: raw)
    assert not node._outputs.listened("image_raw/compressed")
    packed = ros.subscribe("image_raw/compressed", CompressedImage, 50)
    assert wait_until(lambda: {stamp_ns(m.header) for m in raw} & stamps_of(packed))
    message = packed[-1]
    assert wait_until(lambda: stamp_ns(message.header) in {stamp_ns(m.header) for m in raw})
    (frame,) = (m for m in raw if stamp_ns(m.header) == stamp_ns(message.header))
    assert message.format.startswith(form)
    assert message.header.frame_id == frame.header.frame_id
    pixels, _ = array_from_compressed(message)
    assert (np.array_equal(pixels, array_from_image(frame))) == kept


def test_lower_quality_makes_smaller_messages(ros, camera_file, folder):
    sizes = []
    for quality in (95, 30):
        parameters = {f"{COMPRESSED}.format": "jpeg", f"{COMPRESSED}.jpeg_quality": quality}
        node = drive(ros, camera_file, folder, **parameters)
        packed = ros.subscribe("image_raw/compressed", CompressedImage)
        assert wait_until(lambda: packed)  # noqa: B023
        sizes.append(len(packed[-1].data))
        ros.remove(node)
    assert sizes[1] < 0.7 * sizes[0]


def stamps_of(messages):
    return {stamp_ns(message.header) for message in messages}


def test_a_video_is_published(ros, camera_file, tmp_path):
    write_video(tmp_path / "video.avi")
    images = ros.subscribe("image_raw", Image, 50)
    drive(ros, camera_file, tmp_path / "video.avi", loop=False)
    assert wait_until(lambda: len(images) == 5)
    means = [array_from_image(image).mean() for image in images]
    np.testing.assert_allclose(means, [0, 40, 80, 120, 160], atol=4)


def test_a_device_that_vanishes_is_tried_again(ros, camera_file, tmp_path):
    """A stream that is not there yet, comes, ends and comes again."""
    address = f"file://{tmp_path}/stream.avi"
    images = ros.subscribe("image_raw", Image, 50)
    node = drive(ros, camera_file, address)
    time.sleep(0.3)
    assert images == [] and node.context.ok()
    write_video(tmp_path / "stream.avi")
    assert wait_until(lambda: len(images) >= 10)
    assert stamp_ns(images[5].header) - stamp_ns(images[4].header) > 400_000_000


def test_a_camera_that_hangs_is_not_read_by_two_threads(ros, camera_file, folder, monkeypatch):
    monkeypatch.setattr("coded_aperture_ros.ros.camera_driver_node.LONGEST_FRAME_S", 0.1)
    images = ros.subscribe("image_raw", Image, 50)
    node = drive(ros, camera_file, folder)
    assert wait_until(lambda: images)
    goes_on, hangs, read = threading.Event(), threading.Event(), node._source.read

    def hang():
        hangs.set()
        goes_on.wait()
        return read()

    monkeypatch.setattr(node._source, "read", hang)
    assert hangs.wait(scaled(5))
    assert node.trigger_deactivate() == TransitionCallbackReturn.SUCCESS
    assert node.trigger_activate() != TransitionCallbackReturn.SUCCESS
    goes_on.set()
    node._thread.join(scaled(5))
    count = len(images)
    assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS
    assert wait_until(lambda: len(images) > count + 2)


def test_waiting_for_the_next_frame_is_not_work(ros, camera_file, folder):
    images = ros.subscribe("image_raw", Image, 50)
    node = drive(ros, camera_file, folder, rate_hz=4.0)
    assert wait_until(lambda: len(images) > 2)
    assert node.statistics.summary().work_s[0] < 0.125


def test_a_missing_device_is_an_input_error():
    source = DeviceSource("/dev/video_that_is_not_there")
    for _ in range(2):
        with pytest.raises(InputError, match="video_that_is_not_there"):
            source.read()
    source.close()


def test_what_a_camera_changes_by_itself_is_told(tmp_path):
    """V4L2 says 1 for an exposure by hand and 3 for an automatic one; a file says nothing."""
    assert automatic_controls(1.0, 3.0) == ("focus", "exposure")
    assert automatic_controls(-1.0, 1.0) == automatic_controls(0.0, 0.0) == ()
    write_video(tmp_path / "stream.avi")
    source = DeviceSource(f"file://{tmp_path}/stream.avi")
    assert source.read() is not None and source.automatic == ()
    source.close()


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"source": "/nowhere/pictures"}, "/nowhere/pictures"),
        ({"source": ""}, "source is empty"),
        ({"camera_file": ""}, "camera_file is empty"),
        ({"encoding": "yuv422"}, "one of mono8, rgb8, bgr8, mono16, bayer_rggb8, bayer_rggb16"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"base.frame": "eye", "frame_id": "eye"}, "base.frame: eye is frame_id, too"),
    ],
)
def test_what_cannot_be_driven_is_one_clear_line(ros, camera_file, folder, parameters, reason):
    with pytest.raises(InputError) as caught:
        drive(ros, **{"camera_file": camera_file, "source": folder, **parameters})
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_pictures_of_another_shape_have_no_camera_info(ros, camera_file, tmp_path):
    cv2.imwrite(str(tmp_path / "wide.png"), np.zeros((HEIGHT, 2 * WIDTH), np.uint8))
    images, infos = ros.subscribe("image_raw", Image), ros.subscribe("camera_info", CameraInfo)
    drive(ros, camera_file, tmp_path)
    assert wait_until(lambda: len(images) > 3)
    assert infos == []


def test_simulated_time_without_a_clock(ros, camera_file, folder):
    images = ros.subscribe("image_raw", Image)
    drive(ros, camera_file, folder, use_sim_time=True)
    assert wait_until(lambda: len(images) > 3)
    assert stamp_ns(images[0].header) == 0


@pytest.mark.parametrize("source", ["simulator", "folder"])
def test_simulated_time_that_the_driver_makes_goes_on(ros, camera_file, folder, source):
    clock, images = ros.subscribe("/clock", Clock), ros.subscribe("image_raw", Image)
    source = folder if source == "folder" else source
    node = drive(ros, camera_file, source, use_sim_time=True, publish_clock=True)
    assert wait_until(lambda: len(clock) > 5 and len(images) > 5)
    stamps = [stamp_ns(image.header) for image in images]
    assert 0 < stamps[0] < stamps[-1] and stamps == sorted(stamps)
    assert node.get_clock().now().nanoseconds >= stamps[0]


def test_a_transform_is_no_condition(ros, camera_file, folder):
    """tf2_msgs is not everywhere; the frames come all the same."""
    images = ros.subscribe("image_raw", Image)
    drive(ros, camera_file, folder, **{"base.frame": "base_link", "base.z_m": 0.5})
    assert wait_until(lambda: images)


def test_no_cycle_leaves_a_publisher_of_the_transform_behind(ros, camera_file, folder, monkeypatch):
    message_type = stand_in(monkeypatch)
    latched = QoSProfile(depth=9, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    received = ros.subscribe("/tf_static", message_type, latched)

    def publishers():
        return len(ros.probe.get_publishers_info_by_topic("/tf_static"))

    node = drive(ros, camera_file, folder, **{"base.frame": "base_link"})
    for number in range(1, 4):
        assert wait_until(lambda number=number: len(received) == number)
        assert wait_until(lambda: publishers() == 1)
        assert ros.call(node.trigger_deactivate).name == "SUCCESS"
        assert ros.call(node.trigger_cleanup).name == "SUCCESS"
        assert wait_until(lambda: publishers() == 0)
        assert ros.call(node.trigger_configure).name == "SUCCESS"
        assert ros.call(node.trigger_activate).name == "SUCCESS"


@pytest.mark.parametrize("name", ["\u00b2", "\u2460", "\u00bd", "1\u00b2", "-1", "1.0", " 1"])
def test_no_digit_of_a_camera_is_a_name_of_files(camera_file, name):
    """Superscripts and fractions count as digits for `str.isdigit` or `str.isnumeric`."""
    for open_ in (check_source, lambda text: open_source(text, load_camera(camera_file), 10.0)):
        with pytest.raises(InputError, match="no such file") as caught:
            open_(name)
        assert name in str(caught.value)


def test_sources_by_name(camera_file, folder):
    camera = load_camera(camera_file)
    assert isinstance(open_source("0", camera, 10.0), DeviceSource)
    assert isinstance(open_source("/dev/video7", camera, 10.0), DeviceSource)
    assert isinstance(open_source("rtsp://camera/stream", camera, 10.0), DeviceSource)
    assert isinstance(open_source(str(folder), camera, 10.0), PictureSource)


def test_the_simulators_noise_is_as_asked(camera_file):
    camera = load_camera(camera_file)
    quiet, noisy = (SimulatorSource(camera, 10.0, SensorModel(noise)) for noise in (0.0, 0.01))
    for _ in range(3):
        clean, view = quiet.read(), noisy.read()
        difference = view.frame - clean.frame
        assert difference.std() == pytest.approx(0.01, rel=0.05)
        assert abs(difference.mean()) < 0.001
        np.testing.assert_array_equal(view.depth_m, clean.depth_m)


@pytest.mark.parametrize(("changes", "nearest", "farthest"), [
    ({"focus_distance_m": 0.57}, 0.639, 1.521),
    ({"focus_distance_m": 1.3676}, 1.53, 3.65),
    ({"focus_distance_m": 6.0, "side": "near"}, 2.2, 5.41),
])  # fmt: skip
def test_the_simulators_scene_lies_on_the_cameras_side_of_its_focus(changes, nearest, farthest):
    camera = camera_from_mapping({**CAMERA, **changes})
    depth_m = SimulatorSource(camera, 10.0, SensorModel()).read().depth_m
    assert nearest <= depth_m.min() < depth_m.max() <= farthest


LIGHT = {"width": 640, "height": 480, "full_well": 2000, "read_noise": 40, "binning": 1}


@pytest.mark.parametrize(("sensor", "given", "noise"), [
    (None, {}, (0.0012, 0.0018)),  # of the grey of three channels with 0.002
    (None, {"simulation.noise": 0.0}, (0.0, 0.0)),
    (None, {"simulation.noise": 0.02}, (0.012, 0.018)),
    (LIGHT, {}, (0.012, 0.03)),  # read noise of 40 of 2000 electrons, and shot noise
    (LIGHT, {"simulation.noise": 0.002}, (0.0012, 0.0018)),
])  # fmt: skip
def test_the_simulators_noise_is_that_of_the_sensor_unless_it_is_given(
    ros, tmp_path, sensor, given, noise
):
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump({**CAMERA, **({"sensor": sensor} if sensor else {})}))
    images = ros.subscribe("image_raw", Image)
    drive(ros, path, "simulator", encoding="mono16", **given)
    assert wait_until(lambda: len(images) > 4)
    frames = [array_from_image(image) / 65535 for image in images[:5]]
    # The scene hardly moves at first.
    least = min(float(np.std(after - before)) for before, after in pairwise(frames)) / np.sqrt(2)
    assert noise[0] <= least <= noise[1]
