"""Files, camera models and stamps of any kind, with what is right known: right, or refused.

Eight hundred cases in all; with FUZZ_TIMES=1, as `make fuzz` sets it, more than eight thousand.
"""

import dataclasses
import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from bag_scene import IMAGE, STORE, camera_info, image
from fuzzing import cases
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer
from small_camera import CAMERA

from coded_aperture_ros.bags import Bag, BagMessage
from coded_aperture_ros.bags.camera_infos import with_infos
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io import read_image
from coded_aperture_ros.io.messages import check_camera_info, contradiction, view_from_camera_info
from coded_aperture_ros.optics import camera_from_mapping
from coded_aperture_ros.optics.distortion import pixel_rays


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz_truth")


def stored(seed, dtype, shape):
    random = np.random.default_rng(seed)
    if dtype == "f4":
        return random.random(shape, np.float32)
    return random.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


def light(pixels, largest=None):
    if pixels.dtype.kind == "f":
        return pixels
    return pixels / np.float32(largest or np.iinfo(pixels.dtype).max)


@given(data=st.data())
@cases(2500)
def test_tiff(folder, data):
    """Every layout gives the pixels as they are stored, or is refused."""
    tifffile = pytest.importorskip("tifffile")
    draw, options = data.draw, {}
    dtype = draw(st.sampled_from(["u1", "u2", "f4"]))
    rows, columns = draw(st.integers(1, 40)), draw(st.integers(1, 40))
    colour = draw(st.booleans())
    pixels = stored(draw(st.integers(0, 999)), dtype, (rows, columns, 3)[: 2 + colour])
    expected = light(pixels)
    options["photometric"] = (
        "rgb" if colour else draw(st.sampled_from(["minisblack", "miniswhite"]))
    )
    written = pixels
    if options["photometric"] == "miniswhite" and dtype != "f4":
        written = np.iinfo(dtype).max - pixels
    if colour and draw(st.booleans()):
        options["planarconfig"], written = "separate", np.moveaxis(pixels, -1, 0).copy()
    if draw(st.booleans()):
        options["rowsperstrip"] = draw(st.integers(1, rows))
    elif draw(st.booleans()):
        options["tile"] = (16, 32)
    options["compression"] = draw(st.sampled_from([None, "zlib"]))
    if draw(st.booleans()):
        options["extratags"] = [(274, "H", 1, draw(st.integers(1, 8)), True)]
    whole = {"bigtiff": draw(st.booleans()), "byteorder": draw(st.sampled_from("<>"))}
    path = folder / "fuzzed.tif"
    tifffile.imwrite(path, written, **options, **whole)
    try:
        found = read_image(path, 1.0)
    except InputError as error:
        assert "fuzzed.tif" in str(error) and "\n" not in str(error)
        return
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, atol=2e-6)


@given(data=st.data())
@cases(1200)
def test_pnm(folder, data):
    draw = data.draw
    largest = draw(
        st.sampled_from([1, 15, 255, 256, 1023, 4095, 16383, 65535]) | st.integers(1, 65535)
    )
    rows, columns, colour = draw(st.integers(1, 20)), draw(st.integers(1, 20)), draw(st.booleans())
    shape = (rows, columns, 3)[: 2 + colour]
    pixels = stored(draw(st.integers(0, 999)), "u4", shape) % np.uint32(largest + 1)
    pixels[0, 0] = largest
    comment = draw(st.sampled_from(["", "# of a camera\n", "#\n# 1 2 3\n"]))
    ascii_ = draw(st.booleans())
    kind = {(False, False): 5, (True, False): 6, (False, True): 2, (True, True): 3}[colour, ascii_]
    head = f"P{kind}\n{comment}{columns} {rows}\n{largest}\n".encode()
    if ascii_:
        body = " ".join(map(str, pixels.ravel())).encode() + b"\n"
    else:
        body = pixels.astype("u1" if largest < 256 else ">u2").tobytes()
    path = folder / ("fuzzed.ppm" if colour else "fuzzed.pgm")
    path.write_bytes(head + body)
    try:
        found = read_image(path, 1.0)
    except InputError as error:
        assert "fuzzed.p" in str(error) and "\n" not in str(error)
        return
    # OpenCV stores small values in 8 bits.
    rounding = 0.5 / 255 if largest < 255 else 0
    np.testing.assert_allclose(found, light(pixels, largest), atol=rounding + 1e-5)


WHOLE = {"width": 640, "height": 480}
FOCAL_PX = 600.0


def info_of(k, roi=(0, 0, 0, 0), binning=1, d=(0.0,) * 5, **changes):
    left, top, columns, rows = roi
    fields = {
        **WHOLE,
        "k": list(k),
        "d": list(d),
        "r": list(np.eye(3).ravel()),
        "p": [0.0] * 12,
        "distortion_model": "plumb_bob",
        "binning_x": binning,
        "binning_y": binning,
        "roi": SimpleNamespace(x_offset=left, y_offset=top, width=columns, height=rows),
    }
    return SimpleNamespace(**{**fields, **changes})


FAULTS = {
    "": lambda info: {},
    "mm": lambda info: {"k": [value / 300 for value in info.k[:8]] + [1.0]},
    "pixels of half the size": lambda info: {"k": [2 * value for value in info.k[:8]] + [1.0]},
    "binned twice": lambda info: {"k": [value / 2 for value in info.k[:8]] + [1.0]},
    "transposed": lambda info: {"k": list(np.reshape(info.k, (3, 3)).T.ravel())},
    "centre": lambda info: {"k": [*info.k[:2], 0.0, *info.k[3:]]},
    "nan in K": lambda info: {"k": [math.nan, *info.k[1:]]},
    "nan in D": lambda info: {"d": [math.nan] * 5},
    "count of D": lambda info: {"d": [0.1] * 3},
    "model": lambda info: {"d": [0.1] * 4, "distortion_model": "double_sphere"},
    "zeros in R": lambda info: {"r": [0.0] * 9},
    "infinity in P": lambda info: {"p": [600.0, 0, math.inf, 0, 0, 600, 0, 0, 0, 0, 1, 0]},
    "P in mm": lambda info: {"p": [2.0, 0, 1, 0, 0, 2, 1, 0, 0, 0, 1, 0]},
}


@given(data=st.data(), fault=st.sampled_from(sorted(FAULTS)))
@cases(1600)
def test_camera_models_against_the_camera_file(data, fault):
    """A right one places the frame; a wrong one is refused or contradicts the file."""
    draw = data.draw
    camera = camera_from_mapping(
        {
            **CAMERA,
            "focal_length_px": FOCAL_PX,
            "image_width": WHOLE["width"],
            "image_height": WHOLE["height"],
        }
    )
    focal_px = FOCAL_PX * draw(st.floats(0.9, 1.1))
    cx, cy = draw(st.floats(280, 360)), draw(st.floats(200, 280))
    binning = draw(st.sampled_from([1, 2, 4]))
    columns, rows = 4 * draw(st.integers(20, 160)), 4 * draw(st.integers(20, 120))
    left, top = draw(st.integers(0, 640 - columns)), draw(st.integers(0, 480 - rows))
    d = (draw(st.floats(-0.3, 0.1)), draw(st.floats(-0.05, 0.1)), 0.001, -0.001, 0.0)
    info = info_of(
        (focal_px, 0.0, cx, 0.0, focal_px, cy, 0.0, 0.0, 1.0),
        (left, top, columns, rows),
        binning,
        d,
    )
    info = SimpleNamespace(**{**vars(info), **FAULTS[fault](info)})
    width, height = columns // binning, rows // binning
    try:
        check_camera_info(info)
        told = contradiction(info, width, height, camera)
    except InputError as error:
        told = str(error)
    assert bool(told) == bool(fault), (fault, told)
    assert "\n" not in told
    if not fault:
        view = view_from_camera_info(info, width, height, camera)
        assert (view.whole_width, view.whole_height) == (640 // binning, 480 // binning)
        assert (view.left, view.top) == pytest.approx((left / binning, top / binning))


COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,)}
# Of prism and tilt, which are small in any lens: larger ones are no lens's.
SMALL = {2, 3, 8, 9, 10, 11, 12, 13}
K = (60.0, 0.0, 31.5, 0.0, 60.0, 23.5, 0.0, 0.0, 1.0)


@given(data=st.data(), model=st.sampled_from(sorted(COEFFICIENTS)), strength=st.floats(-3, 1.5))
@cases(1500)
def test_rays_lead_back_to_their_pixels(data, model, strength):
    count = data.draw(st.sampled_from(COEFFICIENTS[model]))
    units = data.draw(st.lists(st.floats(-1, 1), min_size=count, max_size=count))
    fisheye = model == "equidistant"
    d = [
        unit * (0.05 if index in SMALL and not fisheye else 10**strength)
        for index, unit in enumerate(units)
    ]
    rays = pixel_rays(model, K, tuple(d), 48, 64)
    known = np.isfinite(rays).all(axis=-1)
    assert np.isnan(rays[~known]).all()
    if not known.any():
        return
    none, k = np.zeros(3), np.reshape(K, (3, 3))
    points = np.dstack([rays, np.ones((48, 64))])[known].astype(np.float64).reshape(-1, 1, 3)
    if not any(d) and not fisheye:
        d = [0.0] * 5
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    pixels = project(points, none, none, k, np.array(d))[0].reshape(-1, 2)
    expected = np.stack(np.meshgrid(np.arange(64), np.arange(48)), axis=-1)[known]
    assert np.linalg.norm(pixels - expected, axis=-1).max() < 0.1 + 1e-3 * np.abs(rays[known]).max()


STAMPS_NS = st.sampled_from([0, 1, 10**9, 10**9, 2 * 10**9, 4 * 10**18]) | st.integers(0, 10**18)


def stamped(data, type_name, stamp_ns):
    message = STORE.deserialize_cdr(data, type_name)
    stamp = dataclasses.replace(
        message.header.stamp, sec=stamp_ns // 10**9 % 2**31, nanosec=stamp_ns % 10**9
    )
    header = dataclasses.replace(message.header, stamp=stamp)
    return STORE.serialize_cdr(dataclasses.replace(message, header=header), type_name)


INFO = "sensor_msgs/msg/CameraInfo"
FRAME = image(np.zeros((4, 4), np.uint8), "mono8", 0)


@given(steps=st.lists(st.tuples(st.booleans(), STAMPS_NS), max_size=30))
@cases(900)
def test_each_frame_of_a_bag_gets_the_model_of_its_stamp(steps):
    """If that stamp is of no other frame or model; and some model wherever one came before."""
    messages, infos = [], {}
    for index, (is_frame, stamp_ns) in enumerate(steps):
        stamp_ns = stamp_ns // 10**9 % 2**31 * 10**9 + stamp_ns % 10**9
        if is_frame:
            message = BagMessage("/image", index, stamped(FRAME, IMAGE, stamp_ns))
        else:
            told = camera_info(0, 64, 48, 60.0 + 0.01 * index)
            message = BagMessage("/info", index, stamped(told, INFO, stamp_ns))
            infos[index] = stamp_ns
        messages.append(message)
    found = list(with_infos(messages, "/image", "/info", None))
    assert [message for message, _ in found] == messages
    stamps = [message.stamp_ns for message in messages]
    for index, (_, info) in enumerate(found):
        is_told = stamps[index] != 0 and stamps.count(stamps[index]) == 2
        others = [one for one in infos if one != index and stamps[one] == stamps[index]]
        if steps[index][0] and is_told and others and others[0] < index:
            assert round((info.k[0] - 60.0) / 0.01) == others[0]
        elif steps[index][0] and any(one < index for one in infos):
            assert info is not None


def mcap_of(path, frames, chunk_size, foreign):
    definition = STORE.generate_msgdef(IMAGE, ros_version=2)[0].encode()
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size)
        writer.start("ros2", "fuzz")
        schema = writer.register_schema(IMAGE, "ros2msg", definition)
        channel = writer.register_channel("/image_raw", "cdr", schema)
        others = [writer.register_channel(f"/{kind}", kind, number) for kind, number in foreign]
        for index, frame in enumerate(frames):
            writer.add_message(channel, index, frame, index)
            for other in others:
                writer.add_message(other, index, b'{"a": 1}', index)
        writer.finish()


@given(data=st.data())
@cases(1200)
def test_damaged_mcap_files_give_what_was_recorded(folder, data):
    """What is damaged is told, and what is read is what was recorded, in its order."""
    draw = data.draw
    frames = [image(np.full((4, 6), index, np.uint8), "mono8", index) for index in range(6)]
    frames = [bytes(frame) for frame in frames]
    foreign = draw(
        st.lists(st.sampled_from([("json", 0), ("protobuf", 0)]), max_size=2, unique=True)
    )
    path = folder / "fuzzed.mcap"
    mcap_of(path, frames, draw(st.sampled_from([100, 400, 10_000])), foreign)
    content = bytearray(path.read_bytes())
    whole = bytes(content)
    how = draw(st.sampled_from(["flip", "cut", "zeros", "none"]))
    at = draw(st.integers(0, len(content) - 1))
    if how == "flip":
        content[at] ^= draw(st.integers(1, 255))
    elif how == "cut":
        del content[at:]
    elif how == "zeros":
        end = min(len(content), at + draw(st.integers(1, 200)))
        content[at:end] = bytes(end - at)
    path.write_bytes(content)
    try:
        with Bag(path) as bag:
            found = [bytes(message.data) for message in bag.messages("/image_raw")]
            damage = bag.damage
    except InputError as error:
        assert "fuzzed.mcap" in str(error) and "\n" not in str(error)
        assert how != "none"
        return
    kept = iter(frames)
    in_order = all(message in kept for message in found)
    assert in_order or "may come too late" in damage
    assert len(set(found)) == len(found) and set(found) <= set(frames)
    if len(found) < len(frames):
        assert damage and "\n" not in damage
    if bytes(content) == whole:
        assert found == frames and not damage
