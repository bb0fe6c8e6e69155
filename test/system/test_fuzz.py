"""Whatever comes in, as a message or a file, is used or refused; nothing ends, hangs or grows.

A thousand cases in all; with FUZZ_TIMES=1, as `make fuzz` sets it, more than ten thousand.
"""

import array
import io
import math
import resource
import zipfile

import cv2
import numpy as np
import pytest
import yaml
from fuzzing import cases
from hypothesis import given
from hypothesis import strategies as st
from rclpy.parameter import Parameter
from ros_helpers import Ros
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from small_camera import CAMERA, FAR_M, HEIGHT, NEAR_M, WIDTH, coded_wall
from std_msgs.msg import Header
from waiting import wait_until

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames.frame import StampOrder
from coded_aperture_ros.io.messages import (
    ENCODINGS,
    array_from_image,
    pixels_from_frame,
    sensor_intrinsics,
)
from coded_aperture_ros.likelihood.bank import LearnConfig, learn_bank, load_bank, save_bank
from coded_aperture_ros.optics import Mask, load_camera, load_intrinsics, render_psf_stack
from coded_aperture_ros.ros.camera_info_store import camera_info_path
from coded_aperture_ros.ros.camera_model import DriverInfo
from coded_aperture_ros.ros.deblur_node import DeblurNode
from coded_aperture_ros.ros.depth_node import DepthNode
from coded_aperture_ros.ros.messages import image_from_array, image_from_compressed
from coded_aperture_ros.ros.pairing import StampPairs
from coded_aperture_ros.ros.rgbd_source import depth_in_metres

# The cases of a test may take no more memory than the tests before, and this.
LARGEST_GROWTH_KB = 400_000


@pytest.fixture(autouse=True)
def bounded_memory():
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    grown_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb
    assert grown_kb < LARGEST_GROWTH_KB


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    (folder / "camera.yaml").write_text(yaml.safe_dump(CAMERA))
    camera = load_camera(folder / "camera.yaml")
    stack = render_psf_stack(camera.mask, np.linspace(*camera.blur_range_px(NEAR_M, FAR_M), 6))
    save_bank(learn_bank(stack, LearnConfig(window_px=32, rank=32)), folder / "bank.npz")
    camera.intrinsics.save(folder / "info.yaml")
    cv2.imwrite(str(folder / "mask.png"), (255 * camera.mask.transmission).astype(np.uint8))
    return folder


@pytest.fixture(scope="module")
def nodes(folder):
    """Return a depth node and a deblur node that work whether anyone listens or not."""
    ros = Ros()
    given = {"camera_file": str(folder / "camera.yaml"), "bank": str(folder / "bank.npz")}
    given |= {"near_m": NEAR_M, "far_m": FAR_M, "lazy": False}
    depth = ros.make(DepthNode, {**given, "temporal.frames": 2.0})
    deblur = ros.make(DeblurNode, given)
    # Their threads are done with the preparations once they have handled something: from here on
    # frames are worked on in this thread alone.
    for node, item in ((depth, (Image(), 0.0)), (deblur, (Image(), Image()))):
        node.offer(item)
        assert wait_until(lambda node=node: handled(node), 60)
    yield depth, deblur
    ros.close()


NAMES = st.sampled_from(sorted(ENCODINGS)) | st.text(max_size=12)
COUNTS = st.integers(0, 140) | st.sampled_from([2**16, 2**31, 2**32 - 1])
STAMPS = st.integers(-(2**31), 2**31 - 1)
NANOSECONDS = st.integers(0, 2**32 - 1)


def set_data(message, data):
    message.data = array.array("B", data)


@st.composite
def headers(draw):
    header = Header(frame_id=draw(st.text(max_size=8).filter(lambda text: "\0" not in text)))
    header.stamp.sec, header.stamp.nanosec = draw(STAMPS), draw(NANOSECONDS)
    return header


def bytes_of_pixel(name):
    if name not in ENCODINGS:
        return 3
    return np.dtype(ENCODINGS[name].dtype).itemsize * ENCODINGS[name].channels


@st.composite
def images(draw, names=NAMES):
    """Draw an image message whose fields may contradict each other."""
    name = draw(names)
    image = Image(header=draw(headers()), encoding=name)
    image.width = draw(st.sampled_from([WIDTH, WIDTH // 2, 2 * WIDTH]) | COUNTS)
    image.height = draw(st.sampled_from([HEIGHT, HEIGHT // 2, 2 * HEIGHT]) | COUNTS)
    image.is_bigendian = draw(st.sampled_from([0, 1, 255]))
    row = image.width * bytes_of_pixel(name)
    image.step = draw(st.just(min(row, 2**32 - 1)) | st.sampled_from([row % 1000 + 8]) | COUNTS)
    expected = image.step * image.height
    size = draw(st.just(expected) | st.integers(0, 5000)) if expected < 2**20 else 64
    seed = draw(st.integers(0, 2**16))
    set_data(image, np.random.default_rng(seed).bytes(size))
    return image


def handled(node):
    summary = node.statistics.summary()
    assert "internal" not in summary.rejected, summary.last_error
    return summary.processed + summary.rejected_total


@given(image=images())
@cases(2500)
def test_images(nodes, image):
    node, before = nodes[0], handled(nodes[0])
    node._process_safely((image, 0.0))
    assert handled(node) == before + 1


@given(
    image=images(st.sampled_from(sorted(ENCODINGS))),
    depth=images(st.sampled_from(["32FC1", "32FC1", "16UC1"])),
)
@cases(1000)
def test_pairs_of_frame_and_depth(nodes, image, depth):
    node, before = nodes[1], handled(nodes[1])
    node._process_safely((image, depth))
    assert handled(node) == before + 1


@given(value=st.floats(width=32), share=st.floats(0, 1), seed=st.integers(0, 99))
@cases(300)
def test_any_depth_of_a_good_frame(nodes, folder, value, share, seed):
    wall = coded_wall(load_camera(folder / "camera.yaml"))
    header = Header()
    header.stamp.sec = 7
    random = np.random.default_rng(seed)
    depth = np.where(random.random(wall.shape) < share, np.float32(value), np.float32(2.0))
    frame = image_from_array(pixels_from_frame(wall, "mono8"), "mono8", header)
    before = handled(nodes[1])
    nodes[1]._process_safely((frame, image_from_array(depth, "32FC1", header)))
    assert handled(nodes[1]) == before + 1


@given(depth=images(st.sampled_from(["32FC1", "16UC1", "mono8", "rgb8"])))
@cases(800)
def test_depth_of_rgbd_cameras(depth):
    try:
        found = depth_in_metres(depth)
    except InputError:
        return
    assert np.isfinite(found).any()
    assert not (found <= 0).any()


NUMBERS = st.floats() | st.sampled_from([0.0, 1.0, 400.0, math.nan, math.inf, -1.0])


@st.composite
def camera_infos(draw):
    info = CameraInfo(header=draw(headers()))
    info.width = draw(st.just(WIDTH) | COUNTS)
    info.height = draw(st.just(HEIGHT) | COUNTS)
    info.distortion_model = draw(st.sampled_from(["plumb_bob", "equidistant", "", "none"]))
    info.d = draw(st.lists(NUMBERS, max_size=14))
    for name, count in (("k", 9), ("r", 9), ("p", 12)):
        setattr(info, name, draw(st.lists(NUMBERS, min_size=count, max_size=count)))
    return info


@given(info=camera_infos())
@cases(1000)
def test_camera_infos(nodes, folder, info):
    driver, camera = DriverInfo(), load_camera(folder / "camera.yaml")
    driver.receive(info)
    out = driver.at(info.header).info(camera, (HEIGHT, WIDTH), (HEIGHT // 2, WIDTH // 2), Header())
    assert (out.width, out.height) == (WIDTH // 2, HEIGHT // 2)
    try:
        measured = sensor_intrinsics(info, "camera")
    except InputError:
        return
    assert np.isfinite(measured.camera_matrix).all()


def mutated(draw, data):
    """Return bytes with some changed, cut off or added."""
    changed = bytearray(data)
    for _ in range(draw(st.integers(0, 8))):
        changed[draw(st.integers(0, len(changed) - 1))] = draw(st.integers(0, 255))
    if draw(st.booleans()):
        del changed[draw(st.integers(0, len(changed))) :]
    return bytes(changed) + draw(st.binary(max_size=8))


PICTURE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
COMPRESSED = [cv2.imencode(kind, PICTURE)[1].tobytes() for kind in (".jpg", ".png")]


@given(data=st.data(), format_=st.text(max_size=8).filter(lambda text: "\0" not in text))
@cases(1200)
def test_compressed_images(data, format_):
    message = CompressedImage(format=format_)
    set_data(message, mutated(data.draw, data.draw(st.sampled_from(COMPRESSED))))
    try:
        image = image_from_compressed(message)
    except InputError:
        return
    assert array_from_image(image).size


@given(data=st.data())
@cases(800)
def test_bank_files(folder, data):
    path = folder / "broken.npz"
    path.write_bytes(mutated(data.draw, (folder / "bank.npz").read_bytes()))
    try:
        bank = load_bank(path)
    except InputError as error:
        assert "broken.npz" in str(error)
        assert "\n" not in str(error)
        return
    assert bank.levels == 6


@given(data=st.data())
@cases(400)
def test_bank_files_with_a_foreign_array(folder, data):
    """Whole as an archive, but with one array that does not belong there."""
    path, kept = folder / "foreign.npz", {}
    with np.load(folder / "bank.npz", allow_pickle=False) as arrays:
        kept = {name: arrays[name] for name in arrays.files}
    name = data.draw(st.sampled_from(sorted(kept)))
    shape = data.draw(st.lists(st.integers(0, 5), max_size=3))
    dtype = data.draw(st.sampled_from(["f4", "f8", "i8", "U3", "?", "c8"]))
    kept[name] = np.zeros(shape, dtype)
    if data.draw(st.booleans()):
        del kept[name]
    np.savez(path, **kept)
    try:
        load_bank(path)
    except InputError as error:
        assert "foreign.npz" in str(error)


TEXTS = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=6),
    st.lists(st.floats(), max_size=3), st.dictionaries(st.text(max_size=4), st.integers()),
)  # fmt: skip


@given(
    key=st.sampled_from([*CAMERA, "side", "pixel_pitch_um", "noise"]) | st.text(max_size=6),
    value=TEXTS,
    data=st.data(),
)
@cases(1200)
def test_camera_files(folder, key, value, data):
    path = folder / "fuzzed.yaml"
    text = yaml.safe_dump({**CAMERA, key: value}, allow_unicode=True)
    if data.draw(st.booleans()):
        text = mutated(data.draw, text.encode()).decode("latin-1")
    path.write_text(text)
    try:
        camera = load_camera(path)
    except InputError as error:
        assert "fuzzed.yaml" in str(error)
        return
    assert camera.focal_length_px > 0


@given(data=st.data())
@cases(600)
def test_calibration_files(folder, data):
    path = folder / "fuzzed_info.yaml"
    path.write_bytes(mutated(data.draw, (folder / "info.yaml").read_bytes()))
    try:
        measured = load_intrinsics(path)
    except InputError as error:
        assert "fuzzed_info.yaml" in str(error)
        return
    assert measured.image_width > 0


@given(data=st.data())
@cases(400)
def test_mask_files(folder, data):
    path = folder / "fuzzed.png"
    path.write_bytes(mutated(data.draw, (folder / "mask.png").read_bytes()))
    try:
        mask = Mask.from_file(path)
    except InputError as error:
        assert "fuzzed.png" in str(error)
        return
    assert 0 < mask.open_fraction <= 1


def test_a_bomb_of_a_bank_is_not_unpacked(folder):
    """A small file that says it holds an array of many gigabytes."""
    path, header = folder / "bomb.npz", io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f4", "fortran_order": False, "shape": (10**6, 10**4)}
    )
    with (
        np.load(folder / "bank.npz", allow_pickle=False) as arrays,
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for name in arrays.files:
            archive.writestr(f"{name}.npy", header.getvalue() + bytes(1000))
    with pytest.raises(InputError, match=r"bomb\.npz"):
        load_bank(path)


@given(url=st.text(max_size=20) | st.text(max_size=12).map("file:///".__add__))
@cases(300)
def test_calibration_urls(url):
    try:
        assert camera_info_path(url, "camera").is_absolute()
    except InputError as error:
        assert "camera_info_url" in str(error)


@given(
    steps=st.lists(
        st.tuples(st.booleans(), st.integers(0, 2**62), st.integers(0, 9999)), max_size=60
    )
)
@cases(600)
def test_stamps_in_any_order(steps):
    pairs, order = StampPairs(5, lambda: None, 20_000, lambda message: message), StampOrder()
    for first, stamp, size in steps:
        assert order.follow(stamp) in ("next", "late", "restart")
        pair = pairs.add(first, stamp % 7, size)
        assert pair is None or len(pair) == 2
        assert len(pairs) <= 10


VALUES = st.one_of(
    st.booleans(), st.integers(-(2**63), 2**63 - 1), st.floats(), st.text(max_size=10),
    st.sampled_from(["none", "tv", "full", "half", "nearest", "nothing"]),
)  # fmt: skip


@given(data=st.data())
@cases(500)
def test_parameters(nodes, folder, data):
    node = nodes[0]
    names = sorted(name for name in node._parameters if name != "use_sim_time")
    name = data.draw(st.sampled_from(names))
    before = node.get_parameter(name).value
    value = data.draw(VALUES)
    (result,) = node.set_parameters([Parameter(name, value=value)])
    if not result.successful:
        assert result.reason
        assert node.get_parameter(name).value == before or before != before
    else:
        node.set_parameters([Parameter(name, value=before)])
    wall = coded_wall(load_camera(folder / "camera.yaml"))
    done = handled(node)
    frame = image_from_array(pixels_from_frame(wall, "mono8"), "mono8", Header())
    node._process_safely((frame, 0.0))
    assert handled(node) == done + 1
