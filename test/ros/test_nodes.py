"""depth_node and deblur_node over real DDS."""

import dataclasses
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from coded_aperture_benchmarks.datasets.textures import load_textures
from diagnostic_msgs.msg import DiagnosticArray
from node_chains import DEPTH_OUTPUTS, FREE_SPACE, SECOND, Chain, DeblurChain, mono8, stamped, wall
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy, qos_profile_sensor_data
from scipy.signal import fftconvolve
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2, RegionOfInterest
from small_camera import CAMERA, DEPTH_M, FAR_M, HEIGHT, NEAR_M, WIDTH
from std_msgs.msg import Header
from waiting import wait_until

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth import DepthEstimator, map_size
from coded_aperture_ros.frames import grey_from_mosaic
from coded_aperture_ros.io.messages import (
    array_from_image,
    millimetres_from_depth,
    pixels_from_frame,
)
from coded_aperture_ros.likelihood.bank import (
    LearnConfig,
    learn_bank_for_camera,
    load_bank,
    save_bank,
)
from coded_aperture_ros.likelihood.bank.for_camera import guarded_range
from coded_aperture_ros.optics import load_camera, render_psf
from coded_aperture_ros.optics.distortion import pixel_rays
from coded_aperture_ros.ros import frame_node
from coded_aperture_ros.ros.deblur_node import DeblurNode
from coded_aperture_ros.ros.depth_node import DepthNode
from coded_aperture_ros.ros.diagnostics import DiagnosticsConfig, status_of
from coded_aperture_ros.ros.messages import camera_info_from_camera, image_from_array, stamp_ns
from coded_aperture_ros.ros.scheduling import RateLimit


def test_a_frame_in_gives_depth_out(ros, model, coded):
    chain = Chain(ros, model, **{"output.size": "half"})
    frame = mono8(coded)
    chain.send(frame)
    assert wait_until(lambda: all(chain.received.values()))
    messages = [chain.received[topic][0] for topic in DEPTH_OUTPUTS]
    depth, raw, confidence, deviation, info = messages
    for message in messages:
        assert message.header == frame.header
        assert (message.width, message.height) == (WIDTH // 2, HEIGHT // 2)
    encodings = [message.encoding for message in (depth, raw, confidence, deviation)]
    assert encodings == ["32FC1", "16UC1", "32FC1", "32FC1"]
    metres, millimetres = array_from_image(depth), array_from_image(raw)
    known = np.isfinite(metres)
    assert known.mean() > 0.5
    assert abs(np.median(metres[known]) - DEPTH_M) < 0.06 * DEPTH_M
    np.testing.assert_allclose(millimetres[known], metres[known] * 1000, atol=0.51)
    assert not millimetres[np.isnan(metres)].any()
    certain = array_from_image(confidence)
    assert certain.min() >= 0 and certain.max() <= 1
    std_dev_m = array_from_image(deviation)
    assert np.array_equal(np.isfinite(std_dev_m), known)
    assert 0.002 < np.median(std_dev_m[known]) < 0.1 * DEPTH_M
    assert info.k[0] == pytest.approx(CAMERA["focal_length_px"] / 2)
    assert info.k[2] == pytest.approx((WIDTH // 2 - 1) / 2)


def test_a_bound_on_free_space_where_one_is_asked_for(ros, model, coded):
    fine = {"camera_file": model["camera_file"], "near_m": NEAR_M, "far_m": FAR_M}
    settings = {"learn.level_count": 30, "free_space.risk": 0.01}
    chain = Chain(ros, fine, ("depth/image", FREE_SPACE), **settings)
    frame = mono8(coded)
    chain.send(frame)
    assert wait_until(lambda: all(chain.received.values()))
    (depth,), (bound,) = chain.received.values()
    assert (bound.header, bound.encoding) == (frame.header, "32FC1")
    depth_m, bound_m = array_from_image(depth), array_from_image(bound)
    known = np.isfinite(depth_m)
    assert np.isfinite(bound_m).all() and (bound_m[known] <= depth_m[known] + 1e-5).all()
    assert (bound_m > DEPTH_M).mean() < 0.01
    # Only the network gives bounds: both parameters are refused together, and go on as they were.
    (refused,) = chain.node.set_parameters([Parameter("regularize.method", value="semiglobal")])
    assert not refused.successful and "free_space_risk: needs regularize: learned" in refused.reason
    nearer = array_from_image(chain.result(mono8(coded), FREE_SPACE))
    np.testing.assert_allclose(nearer, bound_m, rtol=0.2)
    (changed,) = chain.node.set_parameters([Parameter("free_space.risk", value=0.0)])
    assert changed.successful
    chain.result(mono8(coded))
    assert len(chain.received[FREE_SPACE]) == 2


def test_the_bound_comes_as_points_too_as_the_lens_distorts(ros, model, coded):
    fine = {"camera_file": model["camera_file"], "near_m": NEAR_M, "far_m": FAR_M}
    settings = {"learn.level_count": 30, "free_space.risk": 0.01}
    chain = Chain(ros, fine, (FREE_SPACE,), **settings)
    clouds = ros.subscribe("depth/free_points", PointCloud2)
    info = camera_info_from_camera(load_camera(model["camera_file"]), stamped())
    info.d = [-0.3, 0.1, 0.0, 0.0, 0.0]
    chain.tell(info)
    bound = array_from_image(chain.result(mono8(coded), FREE_SPACE))
    assert wait_until(lambda: clouds)
    points = np.frombuffer(clouds[-1].data, np.float32).reshape(HEIGHT, WIDTH, 6)
    np.testing.assert_array_equal(points[..., 2], bound)
    through = pixel_rays("plumb_bob", tuple(info.k), tuple(info.d), HEIGHT, WIDTH)
    np.testing.assert_allclose(points[..., :2], bound[..., None] * through, atol=1e-5)


def test_depth_goes_on_where_no_bound_can_be_given(ros, model, coded):
    """The bank has too few levels for the network."""
    chain = Chain(ros, model, ("depth/image", FREE_SPACE))
    before = array_from_image(chain.result(mono8(coded)))
    (changed,) = chain.node.set_parameters([Parameter("free_space.risk", value=0.01)])
    assert changed.successful
    after = array_from_image(chain.result(mono8(coded)))
    assert np.isfinite(after).mean() > 0.9 * np.isfinite(before).mean() > 0.4
    assert wait_until(lambda: chain.received[FREE_SPACE])
    bound = array_from_image(chain.received[FREE_SPACE][-1])
    np.testing.assert_allclose(bound, NEAR_M, rtol=1e-3)
    assert not chain.rejected


def test_a_second_surface_where_it_is_asked_for(ros, model, coded):
    fine = {"camera_file": model["camera_file"], "near_m": NEAR_M, "far_m": FAR_M}
    settings = {"learn.level_count": 30, "second_surface.enabled": True}
    chain = Chain(ros, fine, ("depth/image", *SECOND), **settings)
    frame = mono8(coded)
    chain.send(frame)
    assert wait_until(lambda: all(chain.received.values()))
    (depth,), (second,), (share,) = chain.received.values()
    assert depth.header == second.header == share.header == frame.header
    assert second.encoding == share.encoding == "32FC1"
    second_m, taken = array_from_image(second), array_from_image(share)
    assert second_m.shape == array_from_image(depth).shape
    np.testing.assert_array_equal(np.isnan(second_m), np.isnan(taken))
    # One wall all over.
    assert np.isnan(second_m).mean() > 0.9
    (refused,) = chain.node.set_parameters([Parameter("regularize.method", value="semiglobal")])
    assert not refused.successful and "second_surface: needs regularize: learned" in refused.reason
    (changed,) = chain.node.set_parameters([Parameter("second_surface.enabled", value=False)])
    assert changed.successful
    chain.result(mono8(coded))
    assert len(chain.received[SECOND[0]]) == 1 and not chain.rejected


def test_a_bound_that_cannot_be_given_is_refused(ros, model):
    chain = Chain(ros, model, (), **{"regularize.method": "semiglobal"})
    (refused,) = chain.node.set_parameters([Parameter("free_space.risk", value=0.01)])
    assert not refused.successful and "use 0" in refused.reason


def test_every_encoding_gives_the_same_depth(ros, model, coded):
    chain = Chain(ros, model, subscribe=("depth/image",))
    for encoding in ("mono8", "bgr8", "rgba8", "mono16", "32FC1", "bayer_gbrg8", "bayer_rggb16"):
        pixels = pixels_from_frame(coded, encoding)
        depth = array_from_image(chain.result(image_from_array(pixels, encoding, stamped())))
        assert abs(np.nanmedian(depth) - DEPTH_M) < 0.06 * DEPTH_M, encoding
    assert chain.rejected == {}


def yuv(frame):
    """Return a frame as webcams send it."""
    stored = np.full((HEIGHT, WIDTH, 2), 128, np.uint8)
    stored[..., 0] = np.rint(16 + 219 * frame)
    message = Image(header=stamped(), encoding="yuv422_yuy2", width=WIDTH, height=HEIGHT)
    message.step, message.data = 2 * WIDTH, stored.tobytes()
    return message


def test_frames_of_webcams_give_depth(ros, model, coded):
    chain = Chain(ros, model, subscribe=("depth/image",))
    depth = array_from_image(chain.result(yuv(coded)))
    assert abs(np.nanmedian(depth) - DEPTH_M) < 0.06 * DEPTH_M


@pytest.mark.parametrize(
    ("encoding", "made"), [("", "rgb8"), ("bayer_grbg8", "rgb8"), ("bayer_bggr16", "rgb16")]
)
def test_frames_of_webcams_and_mosaics_are_deblurred_as_rgb(ros, model, coded, encoding, made):
    chain = DeblurChain(ros, model)
    frame = yuv(coded)
    if encoding:
        frame = image_from_array(pixels_from_frame(coded, encoding), encoding, stamped())
    sharp = chain.result(frame)
    assert (sharp.encoding, sharp.width) == (made, WIDTH)


def test_the_drivers_camera_info_is_scaled_and_passed_on(ros, model, coded):
    chain = Chain(ros, model, **{"output.size": "half"})
    chain.tell(calibration(WIDTH, HEIGHT))
    info = chain.result(mono8(coded), "depth/camera_info")
    assert list(info.k) == [205, 0, 29.75, 0, 210, 24.75, 0, 0, 1]
    assert list(info.d) == [0.1, 0, 0, 0, 0]
    assert info.header.frame_id == "front_optical_frame"


def calibration(width, height):
    """Return a camera model for frames of some size."""
    given = CameraInfo(width=width, height=height, distortion_model="plumb_bob")
    scale = width / WIDTH
    k = [410.0 * scale, 0.0, 60.0 * scale, 0.0, 420.0 * scale, 50.0 * scale, 0.0, 0.0, 1.0]
    given.k = k
    given.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    given.d = [0.1, 0.0, 0.0, 0.0, 0.0]
    return given


@pytest.mark.parametrize("factor", [2, 0.5])
def test_a_camera_info_of_another_size_is_scaled_to_the_frames(ros, model, coded, factor):
    chain = Chain(ros, model, **{"output.size": "full"})
    chain.tell(calibration(round(WIDTH * factor), round(HEIGHT * factor)))
    info = chain.result(mono8(coded), "depth/camera_info")
    assert (info.width, info.height) == (WIDTH, HEIGHT)
    assert info.k[0] == pytest.approx(410)
    assert info.k[4] == pytest.approx(420)
    assert list(info.d) == [0.1, 0, 0, 0, 0]
    assert chain.rejected == {}


def test_points_lie_where_distorted_pixels_look(ros, model, coded):
    chain = Chain(ros, model, subscribe=("depth/image",))
    clouds = ros.subscribe("depth/points", PointCloud2)
    given = calibration(WIDTH, HEIGHT)
    given.d = [-0.3, 0.1, 0.001, -0.002, 0.0]
    chain.tell(given)
    depth = array_from_image(chain.result(mono8(coded)))
    assert wait_until(lambda: clouds)
    points = np.frombuffer(clouds[0].data, np.float32).reshape(HEIGHT, WIDTH, 6)
    row, column = np.argwhere(np.isfinite(depth))[0]
    k, d = np.reshape(given.k, (3, 3)), np.array(given.d)
    seen, _ = cv2.projectPoints(
        points[row, column, :3].astype(np.float64), np.zeros(3), np.zeros(3), k, d
    )
    assert seen.ravel() == pytest.approx([column, row], abs=0.05)


def test_depth_is_compressed_for_those_who_ask(ros, model, coded):
    topics = ("depth/image/compressedDepth", "depth/image_raw/compressedDepth")
    chain = Chain(ros, model, subscribe=("depth/image",))
    inverse, whole = (ros.subscribe(topic, CompressedImage) for topic in topics)
    frame = mono8(coded)
    depth = array_from_image(chain.result(frame))
    assert wait_until(lambda: inverse and whole)
    assert inverse[0].header == whole[0].header == frame.header
    assert inverse[0].format == "32FC1; compressedDepth png"
    assert whole[0].format == "16UC1; compressedDepth png"
    scale, offset = np.frombuffer(inverse[0].data, np.float32, 2, offset=4)
    of_inverse, of_whole = (
        cv2.imdecode(np.frombuffer(each[0].data, np.uint8)[12:], cv2.IMREAD_UNCHANGED)
        for each in (inverse, whole)
    )
    known = np.isfinite(depth)
    assert known.any()
    np.testing.assert_array_equal(of_inverse > 0, known)
    np.testing.assert_allclose(scale / (of_inverse[known] - offset), depth[known], rtol=1e-3)
    np.testing.assert_array_equal(of_whole, millimetres_from_depth(depth))


def test_a_surface_at_the_near_end_is_an_obstacle_at_its_distance(ros, model, coded):
    reports = ros.subscribe("/diagnostics", DiagnosticArray)
    chain = Chain(ros, {**model, "near_m": DEPTH_M * 1.05}, subscribe=("depth/image",))
    depth = array_from_image(chain.result(mono8(coded)))
    assert np.isneginf(depth).mean() > 0.2

    def nearest():
        of_node = [s for m in reports for s in m.status if s.name.startswith("depth_node")]
        values = [v.value for s in of_node for v in s.values if v.key == "nearest_obstacle_m"]
        return values and float(values[-1])

    assert wait_until(nearest)
    assert nearest() == pytest.approx(DEPTH_M, rel=0.1)


def test_all_in_focus_frames_are_compressed_for_those_who_ask(ros, model, coded):
    chain = DeblurChain(ros, model)
    compressed = ros.subscribe("deblurred/image/compressed", CompressedImage)
    sharp = array_from_image(chain.result(mono8(coded)))
    assert wait_until(lambda: compressed)
    assert compressed[0].format == "mono8; jpeg compressed "
    picture = cv2.imdecode(np.frombuffer(compressed[0].data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert np.abs(picture.astype(float) - sharp).mean() < 2


@pytest.mark.parametrize("factor", [1000, 100, 0.1])
def test_depth_in_another_unit_is_rejected(ros, model, coded, factor):
    chain = DeblurChain(ros, model)
    frame = mono8(coded)
    chain.images.publish(frame)
    chain.depths.publish(wall(frame.header, depth_m=factor * DEPTH_M))
    assert wait_until(lambda: chain.node.statistics.summary().rejected == {"depth": 1})
    assert "none of the depths" in chain.node.statistics.summary().last_error
    assert chain.result(mono8(coded))


def test_points_bear_the_colours_of_the_frame(ros, model, coded):
    chain = Chain(ros, model, subscribe=("depth/confidence", "depth/std_dev"))
    clouds = ros.subscribe("depth/points", PointCloud2)
    frame = np.dstack([coded, coded / 2, coded / 4])
    message = image_from_array(pixels_from_frame(frame, "bgr8"), "bgr8", stamped())
    confidence = array_from_image(chain.result(message, "depth/confidence"))
    assert wait_until(lambda: chain.received["depth/std_dev"])
    std_dev = array_from_image(chain.received["depth/std_dev"][-1])
    assert wait_until(lambda: clouds)
    assert [f.name for f in clouds[0].fields] == ["x", "y", "z", "rgb", "confidence", "std_dev"]
    points = np.frombuffer(clouds[0].data, np.float32).reshape(HEIGHT, WIDTH, 6)
    packed = points.view(np.uint32)[..., 3]
    colours = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=-1)
    np.testing.assert_array_equal(colours, array_from_image(message))
    np.testing.assert_array_equal(points[..., 4], confidence)
    np.testing.assert_array_equal(points[..., 5], std_dev)


def warnings_of(reports, node):
    of_node = [s for m in reports for s in m.status if s.name.startswith(node)]
    return [s for s in of_node if s.level == s.WARN]


def test_a_camera_info_of_other_proportions_is_told_and_not_used(ros, model, coded):
    depths, deblurs = Chain(ros, model), DeblurChain(ros, model)
    reports = ros.subscribe("/diagnostics", DiagnosticArray)
    assert wait_until(lambda: depths.infos.get_subscription_count() == 2)
    depths.tell(calibration(WIDTH, HEIGHT // 2))
    info = depths.result(mono8(coded), "depth/camera_info")
    assert info.k[0] == pytest.approx(CAMERA["focal_length_px"])
    assert wait_until(lambda: deblurs.infos)
    assert deblurs.infos[0].k[0] == pytest.approx(CAMERA["focal_length_px"])
    for chain, name in ((depths, "depth_node"), (deblurs, "deblur_node")):
        assert wait_until(lambda chain=chain: chain.node.statistics.summary().processed == 1)
        summary = chain.node.statistics.summary()
        assert summary.rejected == {"camera_info": 1}
        assert "128x48, which does not have the proportions of the 128x96" in summary.last_error
        assert wait_until(lambda name=name: warnings_of(reports, name))


def test_layers_that_are_not_found_are_offered_and_stay_silent(ros, model, coded):
    """Whatever the method and the levels: what finds them may come by a parameter."""
    layers = ("depth/motion", "depth/motion/confidence", "depth/side")
    chain = Chain(ros, model, ("depth/image", *layers))
    for topic in layers:
        assert ros.probe.count_publishers(topic) == 1
    for _ in range(3):
        chain.result(mono8(coded))
    time.sleep(0.3)
    assert [len(chain.received[topic]) for topic in layers] == [0, 0, 0]
    assert len(chain.received["depth/image"]) == 3 and not chain.rejected


def test_parameters_are_set_as_by_ros2_param_set(ros, model):
    """`ros2 param set /depth_node temporal.frames 4`: an integer is good for a float."""
    node = Chain(ros, model, subscribe=()).node
    client = ros.probe.create_client(SetParameters, "depth_node/set_parameters")
    assert wait_until(client.service_is_ready)
    value = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=6)
    parameter = ParameterMessage(name="temporal.frames", value=value)
    answer = client.call_async(SetParameters.Request(parameters=[parameter]))
    assert wait_until(answer.done)
    assert answer.result().results[0].successful, answer.result().results[0].reason
    assert node.get_parameter("temporal.frames").value == 6.0
    for kind in (ParameterType.PARAMETER_DOUBLE_ARRAY, ParameterType.PARAMETER_INTEGER_ARRAY):
        empty = ParameterMessage(name="lazy", value=ParameterValue(type=kind))
        answer = client.call_async(SetParameters.Request(parameters=[empty]))
        assert wait_until(answer.done)
        assert "expected 'Type.BOOL'" in answer.result().results[0].reason


def bad_messages():
    good = np.zeros((HEIGHT, WIDTH), np.uint8)

    def broken(**changes):
        message = image_from_array(good, "mono8", stamped())
        for name, value in changes.items():
            setattr(message, name, value)
        return message

    return [
        ("encoding", broken(encoding="nv21")),
        ("data", broken(data=bytes(100))),
        ("data", broken(data=b"")),
        ("step", broken(step=WIDTH - 1)),
        ("size", broken(width=0)),
        ("size", broken(height=0)),
        ("size", mono8(np.zeros((HEIGHT, WIDTH + 40), np.float32))),
        ("size", mono8(np.zeros((12, 16), np.float32))),
    ]


def test_malformed_messages_are_counted_and_survived(ros, model, coded):
    chain = Chain(ros, model, subscribe=("depth/image",))
    expected = {}
    for kind, message in bad_messages():
        chain.send(message)
        expected[kind] = expected.get(kind, 0) + 1
        assert chain.rejected == expected, message.encoding
    assert chain.received["depth/image"] == []
    depth = array_from_image(chain.result(mono8(coded)))
    assert abs(np.nanmedian(depth) - DEPTH_M) < 0.06 * DEPTH_M


@pytest.mark.parametrize("value", [0.0, 1.0, np.nan, np.inf])
def test_frames_without_information_give_no_depth(ros, model, value):
    chain = Chain(ros, model)
    pixels = np.full((HEIGHT, WIDTH), value, np.float32)
    depth = chain.result(image_from_array(pixels, "32FC1", stamped()))
    assert np.isnan(array_from_image(depth)).all()
    assert wait_until(lambda: chain.received["depth/confidence"])
    confidence = array_from_image(chain.received["depth/confidence"][0])
    assert np.isfinite(confidence).all() and confidence.max() < 0.5


def test_a_resized_frame_is_not_measured_with_a_bank_of_another_size(ros, model, coded, tmp_path):
    """Twice the size of the camera file: the same blur in pixels is another depth then."""
    bank = dataclasses.replace(load_bank(model["bank"]), image_width=128, image_height=96)
    save_bank(bank, tmp_path / "bank.npz")
    chain = Chain(ros, {**model, "bank": str(tmp_path / "bank.npz")})
    chain.send(mono8(np.tile(coded, (2, 2))))
    assert wait_until(lambda: chain.node.statistics.summary().rejected.get("size"))
    reason = chain.node.statistics.summary().last_error
    assert "the bank is for 128x96" in reason
    assert "learn a bank for 256x192" in reason
    assert "--frame-scale 0.5" in reason
    assert not chain.received["depth/image"]
    chain.result(mono8(coded))  # the node goes on


def test_a_bank_for_another_setting_is_refused_at_start(ros, model, tmp_path):
    bank = dataclasses.replace(load_bank(model["bank"]), setting_digest="another")
    save_bank(bank, tmp_path / "bank.npz")
    with pytest.raises(InputError, match=r"another setting of the camera.*learn --remap"):
        Chain(ros, {**model, "bank": str(tmp_path / "bank.npz")})


def test_a_range_that_the_bank_does_not_reach_into_is_refused_at_start(ros, model):
    for range_m in ({"near_m": 60.0, "far_m": 90.0}, {"near_m": 0.1, "far_m": 0.2}):
        with pytest.raises(InputError, match=r"near_m, far_m: .*the bank's levels are at"):
            Chain(ros, {**model, **range_m})


def test_frames_that_do_not_fit_are_told(ros, model, coded, capfd):
    chain = Chain(ros, {**model, "temporal.frames": 0.0}, subscribe=("depth/image",))
    chain.result(mono8(coded))
    good = chain.node.statistics.summary()
    assert good.figures["health"] > 0.5
    assert good.complaint is None
    large = cv2.resize(coded, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    depth = array_from_image(chain.result(mono8(np.clip(large[:96, :128], 0, 1))))
    bad = chain.node.statistics.summary()
    assert bad.figures["health"] < 0.5
    assert "does not fit" in bad.complaint.text
    status = status_of("/depth_node", bad, good, DiagnosticsConfig())
    assert status.level == (b"\2" if bad.complaint.serious else b"\1")
    assert bad.complaint.text in status.message
    assert not bad.complaint.serious or np.isnan(depth).all()
    chain.result(mono8(np.clip(large[:96, :128], 0, 1)))
    # Once, however many frames do not fit one after the other.
    assert capfd.readouterr().err.count("does not fit") == 1


@pytest.mark.parametrize("learned_here", [False, True])
def test_a_resized_frame_is_accepted(ros, model, coded, learned_here):
    """By a bank that does not know its size, and by one that is learned for it."""
    learned = {"bank": "", "learn.level_count": 20, "learn.window_px": 32}
    chain = Chain(ros, {**model, **(learned if learned_here else {})})
    depth = array_from_image(chain.result(mono8(np.tile(coded, (2, 2)))))
    camera = load_camera(model["camera_file"])
    expected = camera.scaled(2).depth_m(camera.blur_size_px(DEPTH_M))
    assert NEAR_M < expected < 0.8 * DEPTH_M
    assert abs(np.median(depth[np.isfinite(depth)]) - expected) < 0.06 * expected
    assert wait_until(lambda: chain.received["depth/camera_info"])
    assert chain.received["depth/camera_info"][0].k[0] == pytest.approx(800.0)


def test_compressed_frames_are_taken_to_be_noisier(ros, model, coded, monkeypatch):
    heard, estimate = [], DepthEstimator.estimate

    def listen(estimator, frame, size):
        heard.append(frame.compression_noise)
        return estimate(estimator, frame, size)

    monkeypatch.setattr(DepthEstimator, "estimate", listen)
    node = ros.make(DepthNode, {**model, "image_transport": "compressed"})
    depths = ros.subscribe("depth/image", Image)
    frames = ros.publisher("image_raw/compressed", CompressedImage)
    assert wait_until(frames.get_subscription_count)
    for suffix, quality in ((".png", ()), (".jpg", (cv2.IMWRITE_JPEG_QUALITY, 50))):
        data = cv2.imencode(suffix, np.rint(255 * coded), quality)[1].tobytes()
        count = len(depths)
        frames.publish(CompressedImage(header=stamped(), format=suffix[1:], data=data))
        assert wait_until(lambda count=count: len(depths) > count)
        assert node.statistics.summary().rejected == {}
        # The median step of the standard's luminance table is 56.5.
        lost = (suffix == ".jpg") * 0.35 * 56.5 / 255 / np.sqrt(12)
        assert heard[-1] == pytest.approx(lost, rel=0.01)


@pytest.mark.parametrize(
    ("kind", "transport", "bayer"),
    [
        ("bayer_gbrg8; png compressed ", "compressed", ""),
        ("mono8; png compressed ", "compressed", "gbrg"),
        ("mono8", "raw", "gbrg"),
    ],
)
def test_mosaics_are_taken_in_every_form(ros, model, coded, monkeypatch, kind, transport, bayer):
    """Compressed, or called grey by a driver."""
    heard, estimate = [], DepthEstimator.estimate

    def listen(estimator, frame, size):
        heard.append(frame.light)
        return estimate(estimator, frame, size)

    monkeypatch.setattr(DepthEstimator, "estimate", listen)
    parameters = {"image_transport": transport, "frames.bayer": bayer}
    node = ros.make(DepthNode, {**model, **parameters})
    depths = ros.subscribe("depth/image", Image)
    mosaic = np.rint(255 * coded).astype(np.uint8)
    if transport == "raw":
        frames = ros.publisher("image_raw", Image)
        message = image_from_array(mosaic, kind, stamped())
    else:
        frames = ros.publisher("image_raw/compressed", CompressedImage)
        data = cv2.imencode(".png", mosaic)[1].tobytes()
        message = CompressedImage(header=stamped(), format=kind, data=data)
    assert wait_until(frames.get_subscription_count)
    frames.publish(message)
    assert wait_until(lambda: depths)
    assert node.statistics.summary().rejected == {}
    expected = grey_from_mosaic((mosaic / 255).astype(np.float32), "gbrg")
    np.testing.assert_allclose(heard[-1], expected, atol=1e-5)


def test_damaged_jpeg_frames_are_rejected_and_counted(ros, model, coded):
    pytest.importorskip("numba")
    node = ros.make(DepthNode, {**model, "image_transport": "compressed"})
    ros.subscribe("depth/image", Image)
    frames = ros.publisher("image_raw/compressed", CompressedImage)
    assert wait_until(frames.get_subscription_count)
    data = cv2.imencode(".jpg", np.rint(255 * coded))[1].tobytes()
    middle = len(data) // 2
    damaged = data[:middle] + bytes(len(data) // 10) + data[middle + len(data) // 5 :]
    frames.publish(CompressedImage(header=stamped(), format="jpeg", data=damaged))
    assert wait_until(lambda: node.statistics.summary().rejected == {"data": 1})


def file_of_whole_view(folder, focal_length_px):
    """Write the camera file of a sensor with twice as many columns and rows as a frame."""
    whole = CAMERA | {
        "focal_length_px": focal_length_px,
        "image_width": 2 * WIDTH,
        "image_height": 2 * HEIGHT,
    }
    path = folder / "whole.yaml"
    path.write_text(yaml.safe_dump(whole))
    return path


@pytest.mark.parametrize("learned_here", [False, True])
def test_a_region_of_interest_has_the_blur_of_the_whole_view(
    ros, model, coded, tmp_path, learned_here
):
    path = file_of_whole_view(tmp_path, 400.0)
    bank = dataclasses.replace(
        load_bank(model["bank"]), image_width=2 * WIDTH, image_height=2 * HEIGHT
    )
    save_bank(bank, tmp_path / "bank.npz")
    learned = {"bank": "", "learn.level_count": 20, "learn.window_px": 32}
    chosen = learned if learned_here else {"bank": str(tmp_path / "bank.npz")}
    chain = Chain(ros, {**model, **chosen, "camera_file": str(path)})
    given = camera_info_from_camera(load_camera(path), Header())
    given.roi = RegionOfInterest(x_offset=64, y_offset=32, width=WIDTH, height=HEIGHT)
    chain.tell(given)
    depth = array_from_image(chain.result(mono8(coded)))
    assert abs(np.nanmedian(depth) - DEPTH_M) < 0.06 * DEPTH_M
    assert wait_until(lambda: chain.received["depth/camera_info"])
    (info,) = chain.received["depth/camera_info"]
    assert (info.width, info.height, info.roi.width) == (WIDTH, HEIGHT, 0)
    assert (info.k[0], info.k[2], info.k[5]) == (400.0, 127.5 - 64, 95.5 - 32)
    assert chain.rejected == {}


def test_a_bank_is_learned_again_for_pixels_that_the_driver_bins(ros, model, coded, tmp_path):
    path = file_of_whole_view(tmp_path, 800.0)
    camera = load_camera(path)
    full = LearnConfig(window_px=64, rank=48)
    bank = learn_bank_for_camera(camera, NEAR_M, FAR_M, level_count=16, config=full)
    save_bank(bank, tmp_path / "bank.npz")
    chosen = {"camera_file": str(path), "bank": str(tmp_path / "bank.npz")}
    chain = Chain(ros, {**model, **chosen})
    chain.send(mono8(coded))
    assert wait_until(lambda: chain.node.statistics.summary().rejected.get("size"))
    given = camera_info_from_camera(camera, Header())
    given.binning_x = given.binning_y = 2
    chain.tell(given)
    depth = array_from_image(chain.result(mono8(coded)))
    assert abs(np.nanmedian(depth) - DEPTH_M) < 0.06 * DEPTH_M


@pytest.mark.parametrize(("near_m", "far_m"), [(1.3, 1.5), (1.3, DEPTH_M), (DEPTH_M, 4.0)])
def test_depth_out_of_the_range_is_infinite_and_the_rest_stays(ros, model, coded, near_m, far_m):
    limits = {"near_m": near_m, "far_m": far_m}
    free = Chain(ros, {**model, "near_m": 0.0, "far_m": 0.0}, subscribe=("depth/image",))
    frame = mono8(coded)
    depth = array_from_image(free.result(frame))
    ros.call(free.node.trigger_deactivate)
    chain = Chain(ros, {**model, **limits}, ("depth/image", "depth/std_dev"))
    limited = array_from_image(chain.result(frame))
    expected = np.where(depth < near_m, -np.inf, np.where(depth > far_m, np.inf, depth))
    np.testing.assert_array_equal(limited, expected.astype(np.float32))
    assert np.isfinite(depth).mean() > 0.4
    assert np.isinf(limited).sum() > 50
    assert wait_until(lambda: chain.received["depth/std_dev"])
    std_dev_m = array_from_image(chain.received["depth/std_dev"][0])
    assert np.array_equal(std_dev_m == np.inf, np.isinf(limited))
    assert np.array_equal(np.isnan(std_dev_m), np.isnan(limited))


def test_no_work_without_a_subscriber(ros, model, coded):
    chain = Chain(ros, model, subscribe=())
    assert wait_until(lambda: chain.images.get_subscription_count() == 0)
    for _ in range(3):
        chain.images.publish(mono8(coded))
    time.sleep(0.3)
    assert chain.node.statistics.summary().received == 0
    received = ros.subscribe("depth/image", Image)
    assert wait_until(chain.connected)
    chain.send(mono8(coded))
    assert wait_until(lambda: received)


def test_laziness_can_be_switched_off(ros, model, coded):
    chain = Chain(ros, model, subscribe=(), lazy=False)
    assert wait_until(chain.connected)
    chain.send(mono8(coded))
    assert chain.node.statistics.summary().processed == 1


def test_a_slow_node_drops_and_works_on_the_newest(ros, model, coded):
    chain = Chain(ros, model, subscribe=("depth/image",))
    frames = [mono8(coded) for _ in range(60)]
    for frame in frames:
        chain.images.publish(frame)
        time.sleep(0.001)
    newest = stamp_ns(frames[-1].header)
    received = chain.received["depth/image"]
    assert wait_until(lambda: received and stamp_ns(received[-1].header) == newest)
    # A frame is counted as processed after its last result has been sent.
    assert wait_until(lambda: chain.handled() == chain.node.statistics.summary().received)
    assert chain.node.statistics.summary().dropped > 0
    stamps = [stamp_ns(message.header) for message in received]
    assert stamps == sorted(stamps)


def test_the_rate_can_be_limited(ros, model, coded, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(frame_node, "RateLimit", lambda: RateLimit(now=lambda: now[0]))
    limit = {"frames.max_rate_hz": 5.0}
    chain = Chain(ros, model, subscribe=("depth/image",), **limit)
    processed = []
    for frame in range(30):
        now[0] = 100 + 0.02 * frame
        chain.send(mono8(coded))
        processed.append(chain.node.statistics.summary().processed)
    taken = [frame for frame in range(30) if processed[frame] > ([0, *processed])[frame]]
    assert taken == [0, 10, 20]
    summary = chain.node.statistics.summary()
    assert summary.dropped_by == {"max_rate": 27}
    assert chain.node.set_parameters([Parameter("frames.max_rate_hz", value=0)])[0].successful
    chain.send(mono8(coded))
    assert chain.node.statistics.summary().processed == 4


def test_parameters_change_what_is_published(ros, model, coded):
    chain = Chain(ros, model, subscribe=("depth/image",))
    assert chain.result(mono8(coded)).width == WIDTH
    (changed,) = chain.node.set_parameters([Parameter("output.size", value="quarter")])
    assert changed.successful
    assert chain.result(mono8(coded)).width == WIDTH // 4
    (refused,) = chain.node.set_parameters([Parameter("confidence.threshold", value=2.0)])
    assert not refused.successful and refused.reason
    (refused,) = chain.node.set_parameters([Parameter("regularize.method", value="magic")])
    assert "one of none, semiglobal, tv, graphcut, learned" in refused.reason
    for how in ("learned", "semiglobal"):
        (changed,) = chain.node.set_parameters([Parameter("regularize.method", value=how)])
        assert changed.successful
        assert chain.result(mono8(coded)).width == WIDTH // 4
    (refused,) = chain.node.set_parameters([Parameter("bank", value="other.npz")])
    assert "read-only" in refused.reason
    (changed,) = chain.node.set_parameters([Parameter("confidence.threshold", value=1.0)])
    assert changed.successful
    assert np.isnan(array_from_image(chain.result(mono8(coded)))).mean() > 0.5


@pytest.mark.parametrize(
    ("frame", "choice", "expected"),
    [
        ((480, 640), "auto", (240, 320)),
        ((240, 320), "auto", (240, 320)),
        ((1080, 1920), "auto", (180, 320)),
        ((600, 320), "auto", (200, 106)),
        ((481, 641), "half", (240, 320)),
        ((480, 640), "full", (480, 640)),
        ((3, 3), "quarter", (1, 1)),
    ],
)
def test_output_size(frame, choice, expected):
    assert map_size(frame, choice) == expected


def test_diagnostics(ros, model, coded):
    chain = Chain(ros, model, subscribe=("depth/image",))
    reports = ros.subscribe("/diagnostics", DiagnosticArray)
    chain.send(mono8(coded))
    chain.send(bad_messages()[0][1])

    def values():
        return {pair.key: pair.value for pair in reports[-1].status[0].values} if reports else {}

    assert wait_until(lambda: values().get("rejected_encoding") == "1")
    assert (values()["received"], values()["processed"]) == ("2", "1")
    assert float(values()["work_median_ms"]) > 0
    assert reports[-1].status[0].name == "depth_node: frames"
    assert reports[-1].status[0].hardware_id == "camera"


@pytest.mark.parametrize("node_type", [DepthNode, DeblurNode])
def test_the_diagnostics_of_a_namespace_name_its_camera(ros, model, node_type):
    reports = ros.subscribe("/diagnostics", DiagnosticArray)
    ros.make(node_type, model, namespace="/robot/front")
    assert wait_until(lambda: reports)
    assert reports[0].status[0].hardware_id == "front"


def test_a_stamp_of_zero_has_no_latency(ros, model, coded):
    chain = Chain(ros, model, use_sim_time=True)  # that has not begun
    chain.send(mono8(coded, Header(frame_id="front_optical_frame")))
    summary = chain.node.statistics.summary()
    assert (summary.processed, summary.latency_s) == (1, None)


def test_subscribers_of_both_kinds_are_served(ros, model, coded):
    chain = Chain(ros, model, subscribe=("depth/image",))
    best_effort = ros.subscribe("depth/image", Image, qos_profile_sensor_data)

    def both_have_one():
        chain.send(mono8(coded))
        return best_effort and chain.received["depth/image"]

    assert wait_until(both_have_one)


def test_default_qos(ros, model):
    Chain(ros, model)
    (image,) = ros.probe.get_subscriptions_info_by_topic("image_raw")
    assert image.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    (depth,) = ros.probe.get_publishers_info_by_topic("depth/image")
    assert depth.qos_profile.reliability == ReliabilityPolicy.RELIABLE


def test_qos_can_be_overridden(ros, model):
    override = {"qos_overrides./image_raw.subscription.reliability": "reliable"}
    Chain(ros, model, **override)
    (image,) = ros.probe.get_subscriptions_info_by_topic("image_raw")
    assert image.qos_profile.reliability == ReliabilityPolicy.RELIABLE


def test_namespace_and_remapping(ros, model, coded):
    node = ros.make(
        DepthNode,
        model,
        namespace="/robot/front",
        cli_args=["--ros-args", "-r", "image_raw:=/lens/raw"],
    )
    received = ros.subscribe("/robot/front/depth/image", Image)
    images = ros.publisher("/lens/raw", Image)
    assert wait_until(images.get_subscription_count)
    images.publish(mono8(coded))
    assert wait_until(lambda: received)
    assert node.get_fully_qualified_name() == "/robot/front/depth_node"


def test_simulated_time_without_a_clock(ros, model, coded):
    chain = Chain(ros, model, subscribe=("depth/image",), use_sim_time=True)
    reports = ros.subscribe("/diagnostics", DiagnosticArray)
    chain.send(mono8(coded))
    assert wait_until(lambda: chain.received["depth/image"])
    assert wait_until(lambda: reports)


@pytest.mark.parametrize("node_type", [DepthNode, DeblurNode])
@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"camera_file": ""}, "camera_file is empty"),
        ({"camera_file": "/nowhere/camera.yaml"}, "/nowhere/camera.yaml"),
        ({"bank": "/nowhere/bank.npz"}, "/nowhere/bank.npz"),
        ({"bank": "", "far_m": 0.0}, "near_m and far_m"),
        ({"near_m": 3.0, "far_m": 2.0}, "near_m 3 must be less than far_m 2"),
        ({"bank": "", "near_m": 0.5}, "focus"),
        ({"learn.level_count": 1}, "learn.level_count"),
        ({"near_m": "close"}, "near_m: expected float"),
    ],
)
def test_what_does_not_load_is_one_clear_line(ros, model, node_type, changes, reason):
    with pytest.raises(InputError) as caught:
        ros.make(node_type, {**model, **changes})
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_bank_is_learned_at_start(ros, model, coded):
    learned = {**model, "bank": "", "learn.level_count": 8, "learn.window_px": 32, "learn.rank": 48}
    chain = Chain(ros, learned, subscribe=("depth/image",))
    depth = array_from_image(chain.result(mono8(coded)))
    assert abs(np.nanmedian(depth) - DEPTH_M) < 0.06 * DEPTH_M
    assert chain.node._pipeline.model.optics_limits


@pytest.mark.parametrize("depth_m", [1.45, 3.2])
def test_both_sides_of_the_focal_plane_by_the_camera_file_alone(ros, model, tmp_path, depth_m):
    both = {"side": "both", "focus_distance_m": 2.0, "mask_extent_mm": 80.0}
    (tmp_path / "camera.yaml").write_text(
        yaml.safe_dump({**CAMERA, **both, "mask": {"name": "three_wide"}})
    )
    camera = load_camera(tmp_path / "camera.yaml")
    psf = render_psf(camera.mask, float(camera.blur_size_px(depth_m)))
    shape = HEIGHT + len(psf) - 1, WIDTH + len(psf) - 1
    (texture,) = load_textures("natural").crops(1, *shape, np.random.default_rng(4))
    frame = fftconvolve(texture, psf, mode="valid")
    frame += 0.001 * np.random.default_rng(0).standard_normal(frame.shape)
    learned = {
        **model,
        "camera_file": str(tmp_path / "camera.yaml"),
        "bank": "",
        "learn.level_count": 21,
    }
    learned.update({"learn.window_px": 48, "learn.rank": 64, "compute.stride_px": 8})
    chain = Chain(ros, learned, subscribe=("depth/image",))
    depth = array_from_image(
        chain.result(image_from_array(frame.astype(np.float32), "32FC1", Header()))
    )
    assert np.isfinite(depth).mean() > 0.3
    assert np.nanmedian(depth) == pytest.approx(depth_m, rel=0.06)


@pytest.mark.parametrize(
    ("near_m", "far_m", "is_what_it_is_called"),
    [(1.3, 1.7, np.isposinf), (1.15, 1.7, np.isposinf), (2.4, 4.0, np.isneginf)],
)
def test_a_learned_bank_knows_what_is_out_of_range(
    ros, model, coded, near_m, far_m, is_what_it_is_called
):
    """And does not take it for something at the end of the range, with full confidence."""
    learned = {**model, "bank": "", "learn.level_count": 8, "learn.window_px": 32, "learn.rank": 48}
    learned.update(near_m=near_m, far_m=far_m)
    chain = Chain(ros, learned, subscribe=("depth/image",))
    depth = array_from_image(chain.result(mono8(coded)))
    assert not np.isfinite(depth).any()
    assert is_what_it_is_called(depth).mean() > 0.5


@pytest.mark.parametrize(
    ("changes", "near_m", "far_m"),
    [
        ({}, 1.3, 4.0),
        ({}, 1.05, 100.0),
        ({"focus_distance_m": 5.0, "side": "near"}, 1.3, 4.0),
        ({"focus_distance_m": 5.0, "side": "near"}, 1.3, 4.99),
        ({"focus_distance_m": 2.0, "side": "both"}, 1.3, 4.0),
    ],
)
def test_a_level_is_learned_on_either_side_of_the_range(tmp_path, changes, near_m, far_m):
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump({**CAMERA, **changes}))
    camera = load_camera(tmp_path / "camera.yaml")
    nearer_m, farther_m, levels = guarded_range(camera, near_m, far_m, 8)
    assert nearer_m < near_m < far_m < farther_m
    assert levels == 10
    blur = camera.blur_range_px(nearer_m, farther_m)  # is a valid range of this camera
    assert np.all(np.abs(blur) > 0) and blur[1] <= camera.blur_at_infinity_px


@pytest.mark.parametrize("encoding", ["mono8", "bgr8", "mono16"])
def test_a_frame_and_its_depth_give_a_sharper_frame(ros, model, coded, encoding):
    chain = DeblurChain(ros, model)
    frame = image_from_array(pixels_from_frame(coded, encoding), encoding, stamped())
    chain.images.publish(frame)
    chain.depths.publish(wall(frame.header))
    assert wait_until(lambda: chain.received and chain.infos)
    sharp = chain.received[0]
    assert sharp.header == chain.infos[0].header == frame.header
    assert (sharp.encoding, sharp.width, sharp.height) == (encoding, WIDTH, HEIGHT)
    assert chain.infos[0].k[0] == CAMERA["focal_length_px"]
    gradient = [
        np.abs(np.diff(array_from_image(message).astype(float), axis=1)).mean()
        for message in (frame, sharp)
    ]
    assert gradient[1] > 1.3 * gradient[0]


def test_only_the_frames_own_depth_is_used(ros, model, coded):
    chain = DeblurChain(ros, model)
    early, late = mono8(coded), mono8(coded)
    chain.images.publish(early)
    assert wait_until(lambda: chain.node.statistics.summary().received == 1)
    chain.images.publish(late)
    chain.depths.publish(wall(stamped()))
    time.sleep(0.3)
    assert chain.received == []
    chain.depths.publish(wall(late.header))
    assert wait_until(lambda: chain.received)
    assert chain.received[0].header == late.header
    summary = chain.node.statistics.summary()
    assert (summary.without_depth, summary.dropped) == (1, 0)


def test_frames_that_come_fast_do_not_push_out_the_one_whose_depth_is_in_work(ros, model, coded):
    """100 frames a second, and a second for the depth of one."""
    chain = DeblurChain(ros, model)
    first = mono8(coded)
    for count, frame in enumerate([first, *(mono8(coded) for _ in range(99))], 1):
        chain.images.publish(frame)
        assert wait_until(lambda n=count: chain.node.statistics.summary().received == n)
    chain.depths.publish(wall(first.header))
    assert wait_until(lambda: chain.received)


def test_frames_do_not_wait_while_nobody_listens(ros, model, coded):
    chain = DeblurChain(ros, model)
    for _ in range(3):
        chain.images.publish(mono8(coded))
    assert wait_until(lambda: chain.node.statistics.summary().received > 0)
    for subscription in list(ros.probe.subscriptions):
        ros.probe.destroy_subscription(subscription)
    assert wait_until(lambda: chain.images.get_subscription_count() == 0)
    summary = chain.node.statistics.summary()
    assert summary.without_depth == summary.received


def test_a_node_that_waits_for_depth_in_vain_says_so(ros, model, coded):
    chain = DeblurChain(ros, model)
    diagnostics = ros.subscribe("/diagnostics", DiagnosticArray)

    def warned():
        chain.images.publish(mono8(coded))
        statuses = [status for message in diagnostics for status in message.status]
        return [s for s in statuses if s.level == s.WARN and "no results" in s.message]

    assert wait_until(warned)


def test_unusable_pairs_are_counted_and_survived(ros, model, coded):
    chain = DeblurChain(ros, model)
    depth = wall(stamped())
    depth.encoding, depth.step = "16UC1", depth.width * 2
    short = wall(stamped())
    short.data = b""
    unknown = wall(stamped(), depth_m=np.nan)
    for bad in (depth, short, unknown):
        before = chain.node.statistics.summary().rejected_total
        chain.images.publish(mono8(coded, bad.header))
        chain.depths.publish(bad)
        assert wait_until(lambda n=before: chain.node.statistics.summary().rejected_total > n)
    assert chain.node.statistics.summary().rejected == {"depth": 2, "data": 1}
    frame = mono8(coded)
    chain.images.publish(frame)
    chain.depths.publish(wall(frame.header))
    assert wait_until(lambda: chain.received)


def test_depth_and_deblurring_together(ros, model, coded):
    depth = ros.make(DepthNode, model)
    deblur = DeblurChain(ros, model)
    assert wait_until(lambda: deblur.images.get_subscription_count() == 2)
    frame = mono8(coded)
    deblur.images.publish(frame)
    assert wait_until(lambda: deblur.received)
    assert deblur.received[0].header == frame.header
    assert depth.statistics.summary().processed == 1


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        (lambda _: {"side": "near", "focus_distance_m": 40.0}, "its side is near"),
        # Levels that are blurred more than infinity have no depths.
        (lambda values: {"mask_extent_mm": values["mask_extent_mm"] / 9}, "infinity"),
    ],
)
def test_a_camera_file_that_cannot_be_used_is_refused_while_the_node_runs(
    ros, model, coded, tmp_path, changed, why, capfd
):
    values = yaml.safe_load(Path(model["camera_file"]).read_text())
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump(values | changed(values)))
    chain = Chain(ros, model)
    (result,) = chain.node.set_parameters([Parameter("camera_file", value=str(other))])
    assert not result.successful
    # Others must not learn what is in files.
    assert "log of the node" in result.reason
    assert why not in result.reason
    assert why in capfd.readouterr().err
    depth = array_from_image(chain.result(mono8(coded)))
    assert abs(np.nanmedian(depth) - DEPTH_M) < 0.06 * DEPTH_M


@pytest.mark.parametrize(
    "content", ["[" * 3000, "/dev/zero", "/etc/passwd", "/", "/missing", "a: &a [*a]"]
)
def test_a_hostile_camera_file_does_not_end_a_node(ros, model, coded, tmp_path, content):
    other = tmp_path / "other.yaml"
    other.write_text(content)
    name = content if content.startswith("/") else str(other)
    chain = Chain(ros, model)
    (result,) = chain.node.set_parameters([Parameter("camera_file", value=name)])
    assert not result.successful
    assert result.reason == "the file or value could not be used: the log of the node says why"
    assert np.isfinite(array_from_image(chain.result(mono8(coded)))).any()
