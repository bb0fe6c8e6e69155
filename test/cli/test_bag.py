"""The command `bag`: real bags in, real bags out, read by rosbags and by mcap's own reader."""

import json
import math
import re

import cv2
import numpy as np
import pytest
from bag_scene import (
    CAMERA_INFO,
    COMPRESSED,
    DELAY_NS,
    FRAME_ID,
    FRAMES,
    IMAGE,
    PERIOD_NS,
    START_NS,
    STORE,
    TF,
    camera_info,
    compressed,
    decoded,
    floats,
    frame_pixels,
    header,
    image,
    read,
    recording,
    stamp_of,
    transform,
    write_bag,
)
from cli_scene import HEIGHT, WIDTH, call, everything, examples, parsed, refused, wrong_usage
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import CompressionMode

from coded_aperture_ros.bags import BagMessage
from coded_aperture_ros.bags.codec import read_picture
from coded_aperture_ros.bags.frame_log import FrameLog
from coded_aperture_ros.bags.frames import DepthMaps, ProcessedFrame
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.io.messages import MessageError, array_from_image

RESULTS = ("depth/image", "depth/confidence", "depth/std_dev", "depth/camera_info")
DEBLURRED = ("deblurred/image", "deblurred/camera_info")
STORAGES = ("mcap", "sqlite3")
FEW_MOTIONS = ("--motion-directions", 2, "--motion-lengths", 2, "--motion-rank", 32)


def command(scene, source, target, *options):
    model = ("--bank", scene.bank, "--camera", scene.camera)
    return ("bag", source, "-o", target, *model, *options)


@pytest.fixture(scope="module")
def processed(scene, tmp_path_factory):
    """A bag of each storage, what was made of it, and what the program said."""
    from coded_aperture_ros.cli.main import main

    folder = tmp_path_factory.mktemp("bags")
    made = {}
    for storage in STORAGES:
        bag = write_bag(folder / f"in_{storage}", recording(scene), storage)
        target = folder / f"out_{storage}"
        arguments = command(scene, bag, target, "--reference-depth", "/truth/depth")
        assert main([str(part) for part in arguments]) == 0
        made[storage] = bag, target
    return made


@pytest.mark.parametrize("storage", STORAGES)
def test_all_messages_are_copied_as_they_were(processed, storage):
    before, after = (read(path) for path in processed[storage])
    topics = {topic for topic, *_ in before}
    assert [message for message in after if message[0] in topics] == before


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("name", RESULTS + DEBLURRED)
def test_every_frame_has_results_with_its_stamps(processed, storage, name):
    found = decoded(read(processed[storage][1]), f"/eye/{name}")
    times = [START_NS + index * PERIOD_NS for index in range(FRAMES)]
    assert [stamp_of(message) for _, message in found] == times
    assert [time_ns for time_ns, _ in found] == [time + DELAY_NS + 1 for time in times]
    assert {message.header.frame_id for _, message in found} == {FRAME_ID}


def test_depth_is_right_and_deblurring_helps(processed, scene):
    messages = read(processed["mcap"][1])
    inside = scene.away_from_the_edge()
    for (_, depth), (_, confidence), (_, deviation) in zip(
        *(decoded(messages, f"/eye/{name}") for name in RESULTS[:3]), strict=True
    ):
        depth_m, sure, std_dev_m = floats(depth), floats(confidence), floats(deviation)
        assert depth_m.shape == sure.shape == std_dev_m.shape == scene.depth_m.shape
        assert np.array_equal(np.isnan(std_dev_m), np.isnan(depth_m))
        assert np.isfinite(depth_m[inside]).mean() > 0.7
        error = np.abs(depth_m - scene.depth_m)[inside] / scene.depth_m[inside]
        assert np.nanmedian(error) < 0.05
        assert ((sure >= 0) & (sure <= 1)).all()
    sharp = scene.sharp @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    (_, coded), (_, deblurred) = (
        decoded(messages, f"/eye/{name}")[0] for name in ("image_raw", "deblurred/image")
    )
    assert deblurred.encoding == "mono8"
    off = [np.abs(array_from_image(m) / 255 - sharp)[inside].mean() for m in (coded, deblurred)]
    assert off[1] < 0.9 * off[0]


def test_a_bag_gets_the_bound_that_is_asked_for(scene, recorded, tmp_path, capsys):
    options = ("--free-space-risk", 0.01, "--deblur", "none")
    assert call(capsys, *command(scene, recorded(1), tmp_path / "out", *options)).status == 0
    messages = read(tmp_path / "out")
    ((_, depth),) = decoded(messages, "/eye/depth/image")
    ((_, bound),) = decoded(messages, "/eye/depth/free_space")
    assert (bound.header, bound.encoding) == (depth.header, "32FC1")
    assert (floats(bound) > scene.depth_m).mean() < 0.01


def test_a_bag_gets_the_second_surface_that_is_asked_for(scene, recorded, tmp_path, capsys):
    options = ("--second-surface", "--deblur", "none")
    assert call(capsys, *command(scene, recorded(1), tmp_path / "out", *options)).status == 0
    messages = read(tmp_path / "out")
    ((_, depth),) = decoded(messages, "/eye/depth/image")
    ((_, second),) = decoded(messages, "/eye/depth/second")
    ((_, share),) = decoded(messages, "/eye/depth/second_share")
    assert depth.header == second.header == share.header and second.encoding == "32FC1"
    assert np.array_equal(np.isnan(floats(second)), np.isnan(floats(share)))


@pytest.mark.parametrize("size", ["full", "half"])
def test_a_bag_gets_the_points_that_are_asked_for(scene, recorded, tmp_path, capsys, size):
    options = ("--points", "--deblur", "none", "--output-size", size)
    result = call(capsys, *command(scene, recorded(1), tmp_path / "out", *options, "--json"))
    assert json.loads(result.out)["outputs"]["points"] == "/eye/depth/points"
    messages = read(tmp_path / "out")
    ((_, depth),) = decoded(messages, "/eye/depth/image")
    ((_, confidence),) = decoded(messages, "/eye/depth/confidence")
    ((_, info),) = decoded(messages, "/eye/depth/camera_info")
    ((_, cloud),) = decoded(messages, "/eye/depth/points")
    assert cloud.header == depth.header
    assert (cloud.height, cloud.width) == (depth.height, depth.width)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "rgb", "confidence", "std_dev"]
    assert cloud.point_step == 24 and cloud.row_step == 24 * cloud.width and not cloud.is_dense
    points = cloud.data.view(np.float32).reshape(cloud.height, cloud.width, 6)
    np.testing.assert_array_equal(points[..., 2], floats(depth))
    np.testing.assert_array_equal(points[..., 4], floats(confidence))
    # The camera model of the bag has distortion: the points are where it says.
    seen = points[np.isfinite(points[..., 2])][::97, :3].astype(float)
    rows, columns = np.nonzero(np.isfinite(points[..., 2]))
    k = info.k.reshape(3, 3)
    found, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), k, info.d)
    expected = np.stack([columns, rows], axis=1)[::97]
    np.testing.assert_allclose(found[:, 0], expected, atol=0.02)


def test_the_camera_model_of_the_bag_is_resized(scene, recorded, tmp_path, capsys):
    bag = recorded(1)
    options = ("--output-size", "half", "--deblur", "none")
    assert call(capsys, *command(scene, bag, tmp_path / "out", *options)).status == 0
    messages = read(tmp_path / "out")
    ((_, depth),) = decoded(messages, "/eye/depth/image")
    ((_, info),) = decoded(messages, "/eye/depth/camera_info")
    assert (depth.height, depth.width) == (info.height, info.width) == (64, 88)
    np.testing.assert_allclose(info.d, [0.1, -0.2, 0, 0, 0.05])
    # The principal point was at 91, 59 of 176 x 128.
    expected = [200, 0, 0.5 * 91.5 - 0.5, 0, 200, 0.5 * 59.5 - 0.5, 0, 0, 1]
    np.testing.assert_allclose(info.k, expected)
    assert not [name for name, *_ in messages if "deblurred" in name]


def region_of(scene, tmp_path, top, left, rows, columns):
    """Write a bag with frames of a region of interest."""
    height, width = scene.depth_m.shape
    part = slice(top, top + rows), slice(left, left + columns)
    messages = []
    for index in range(2):
        time_ns = START_NS + index * PERIOD_NS
        info = camera_info(index, width, height, 400.0, (left, top, rows, columns))
        pixels = frame_pixels(scene, "mono8", index)[part]
        messages += [
            ("/eye/camera_info", CAMERA_INFO, time_ns, info),
            ("/eye/image_raw", IMAGE, time_ns + 1, image(pixels, "mono8", index)),
        ]
    return write_bag(tmp_path / "in", messages)


def test_a_region_of_interest_turns_around_the_axis_of_the_whole_view(
    scene, tmp_path, capsys, monkeypatch
):
    top, left, rows, columns = 16, 24, 96, 136
    bag, priors = region_of(scene, tmp_path, top, left, rows, columns), []

    def processor(pipeline, kind, size, depth_size, gamma, prior, *others):
        priors.append(prior)
        raise InputError("that is enough")

    monkeypatch.setattr("coded_aperture_ros.bags.frames.FrameProcessor", processor)
    options = ("--motion", *FEW_MOTIONS, "--angular-velocity", 0, 0, 1, "--exposure", 0.01)
    refused(call(capsys, *command(scene, bag, tmp_path / "out", *options)), "that is enough")
    middle = (HEIGHT - 1) / 2 - top, (WIDTH - 1) / 2 - left
    still = priors[0].motion_px([middle[0]], [middle[1]], columns)
    np.testing.assert_allclose(still, 0, atol=1e-9)


def test_a_region_of_interest_has_the_blur_of_the_whole_view(scene, tmp_path, capsys):
    top, left, rows, columns = 16, 24, 96, 136
    part = slice(top, top + rows), slice(left, left + columns)
    bag = region_of(scene, tmp_path, top, left, rows, columns)
    result = call(capsys, *command(scene, bag, tmp_path / "out", "--deblur", "none"))
    assert result.status == 0, result.err
    written = read(tmp_path / "out")
    _, depth = decoded(written, "/eye/depth/image")[-1]
    truth, inside = scene.depth_m[part], scene.away_from_the_edge()[part]
    assert np.nanmedian(np.abs(floats(depth) - truth)[inside] / truth[inside]) < 0.05
    _, info = decoded(written, "/eye/depth/camera_info")[-1]
    assert (info.width, info.height, info.roi.width) == (columns, rows, 0)
    np.testing.assert_allclose(info.k[[0, 2, 5]], [400, 91 - left, 59 - top])


def test_compressed_frames_are_taken_to_be_noisier(scene, tmp_path, capsys, caplog):
    noise = []
    for suffix in (".png", ".jpg"):
        quality = (cv2.IMWRITE_JPEG_QUALITY, 50) if suffix == ".jpg" else ()
        frame = compressed(frame_pixels(scene, "mono8", 0), suffix, 0, *quality)
        bag = write_bag(tmp_path / f"in{suffix}", [("/eye/image", COMPRESSED, START_NS, frame)])
        target = tmp_path / f"out{suffix}"
        result = call(capsys, *command(scene, bag, target, "--deblur", "none"))
        assert result.status == (suffix == ".jpg")  # which has no depth
        report = json.loads((target / "report" / "report.json").read_text())
        noise.append(report["series"][0]["noise"])
    # The median step of the standard's luminance table is 56.5.
    assert noise[1] == pytest.approx(0.35 * 56.5 / 255 / np.sqrt(12), rel=0.01)
    assert noise[1] > 2 * noise[0]
    depths = tmp_path / "depths"
    result = call(capsys, "depth", f"bag:{bag}", "--bank", scene.bank, "-o", depths, "--json")
    assert json.loads(result.out)[0]["noise"] == pytest.approx(noise[1], rel=0.01)
    assert "compressed with loss" in caplog.text


@pytest.mark.parametrize("length", range(20, 100, 5))
def test_a_compressed_frame_that_is_cut_off_is_refused(length):
    """Wherever: `quantisation_sigma` would look for a table that is not whole."""
    data = cv2.imencode(".jpg", np.full((8, 8), 90, np.uint8))[1].reshape(-1)[:length]
    message = STORE.types[COMPRESSED](header=header(0), format="jpeg", data=data)
    with pytest.raises(MessageError):
        read_picture(STORE.serialize_cdr(message, COMPRESSED), COMPRESSED)


@pytest.mark.parametrize(("encoding", "expected"), [("mono8", 0.5**2.2), ("mono16", 0.5)])
def test_pictures_of_the_report_are_linear_light(encoding, expected):
    pixels = np.full((4, 6), {"mono8": 127.5, "mono16": 32767.5}[encoding])
    pixels = np.rint(pixels).astype({"mono8": np.uint8, "mono16": np.uint16}[encoding])
    record, data = FrameLog(IMAGE, gamma=2.2), image(pixels, encoding, 0)
    maps = DepthMaps(*np.ones((3, 4, 6), np.float32), 0.002)
    result = ProcessedFrame(header=read_picture(data, IMAGE).header, maps=maps, sharp=pixels)
    record.add(0, BagMessage("/eye/image", START_NS, data), result)
    for shown in (record.samples[0].frame, record.samples[0].sharp):
        assert shown == pytest.approx(np.full((4, 6), expected), rel=0.01)


@pytest.mark.parametrize("storage", STORAGES)
def test_the_report_says_what_the_bag_says(processed, storage):
    """Computed again from the written bag, by other means."""
    target = processed[storage][1]
    report = json.loads((target / "report" / "report.json").read_text())
    messages = read(target)
    truths = {stamp_of(message): message for _, message in decoded(messages, "/truth/depth")}
    sures = [floats(message) for _, message in decoded(messages, "/eye/depth/confidence")]
    deviations = [message for _, message in decoded(messages, "/eye/depth/std_dev")]
    medians, errors, known, covered, promised, kept = [], [], 0, 0, [], []
    for index, (_, message) in enumerate(decoded(messages, "/eye/depth/image")):
        depth_m, truth = floats(message), floats(truths[stamp_of(message)])
        assert depth_m.shape == truth.shape
        has_truth = truth > 0
        both = has_truth & np.isfinite(depth_m)
        error = np.abs(depth_m[both].astype(float) - truth[both]) / truth[both]
        medians.append(float(np.median(error)))
        errors.append(error)
        known, covered = known + has_truth.sum(), covered + both.sum()
        promised.append(sures[index][both])
        kept.append(error <= 0.05)
        row = report["series"][index]
        assert row["median_relative_error"] == pytest.approx(medians[-1], rel=1e-4)
        assert row["coverage"] == pytest.approx(np.isfinite(depth_m).mean())
        assert row["stamp_ns"] == stamp_of(message)
        deviation_m = floats(deviations[index])[np.isfinite(depth_m)]
        assert row["median_std_dev_m"] == pytest.approx(float(np.median(deviation_m)), rel=1e-4)
    every = np.concatenate(errors)
    reference = report["reference"]
    assert reference["frames"] == len(medians) == FRAMES
    assert reference["median_relative_error"] == pytest.approx(np.median(medians), rel=1e-4)
    assert reference["mean_relative_error"] == pytest.approx(every.mean(), rel=1e-4)
    assert reference["within_10_percent"] == pytest.approx((every <= 0.1).mean(), abs=1e-4)
    assert reference["coverage"] == pytest.approx(covered / known)
    assert known == FRAMES * (128 * 176 - 20 * 30)  # the hole has no truth
    sure, right = np.concatenate(promised).astype(float), np.concatenate(kept)
    gaps = [
        abs((sure - right)[(sure >= low / 10) & (sure < (low + 1) / 10)].sum()) for low in range(10)
    ]
    assert reference["expected_calibration_error"] == pytest.approx(sum(gaps) / sure.size, abs=2e-4)


def test_a_reference_in_millimetres_says_the_same(scene, tmp_path, capsys):
    medians = []
    for reference in ("32FC1", "16UC1"):
        bag = write_bag(tmp_path / reference, recording(scene, reference=reference, frames=2))
        arguments = command(scene, bag, tmp_path / f"out_{reference}", "--deblur", "none")
        result = call(capsys, *arguments, "--reference-depth", "/truth/depth", "--json")
        assert (result.status, result.err) == (0, "")
        medians.append(json.loads(result.out)["reference"]["median_relative_error"])
    assert medians[1] == pytest.approx(medians[0], abs=0.0005)


@pytest.mark.parametrize("factor", [1000, 100, -1])
def test_a_reference_in_another_unit_is_told(scene, tmp_path, capsys, caplog, factor):
    messages = recording(scene, frames=1)
    depth_m = 1 / scene.depth_m if factor < 0 else factor * scene.depth_m
    wrong = image(depth_m.astype(np.float32), "32FC1", 0)
    messages = [
        (topic, kind, time_ns, wrong if topic == "/truth/depth" else data)
        for topic, kind, time_ns, data in messages
    ]
    bag = write_bag(tmp_path / "in", messages)
    arguments = command(scene, bag, tmp_path / "out", "--deblur", "none")
    result = call(capsys, *arguments, "--reference-depth", "/truth/depth")
    assert result.status == 0
    assert "/truth/depth: none of the depths" in caplog.text
    assert "they seem to be in" in caplog.text


def test_mcap_tools_read_what_was_written(processed):
    target = processed["mcap"][1]
    expected = decoded(read(target), "/eye/depth/image")
    with (target / f"{target.name}.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary.statistics.message_count == len(read(target))
        types = {
            channel.topic: summary.schemas[channel.schema_id].name
            for channel in summary.channels.values()
        }
        assert types["/eye/deblurred/image"] == types["/eye/image_raw"] == IMAGE
        found = list(reader.iter_decoded_messages(topics=["/eye/depth/image"]))
    assert len(found) == FRAMES
    for (_, _, message, image_), (time_ns, other) in zip(found, expected, strict=True):
        assert message.log_time == time_ns
        assert stamp_of(image_) == stamp_of(other)
        assert bytes(image_.data) == other.data.tobytes()


def test_the_report_is_a_page_by_itself(processed):
    page = (processed["mcap"][1] / "report" / "report.html").read_text()
    sources = re.findall(r'(?:src|href)="([^"]{0,30})', page)
    assert len(sources) >= 2 + 4 * FRAMES
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert "http" not in page
    for words in ("median error", "calibration error", "times real time", "all in focus"):
        assert words in page


@pytest.mark.parametrize(
    ("encoding", "padding", "made"),
    [
        ("mono16", 0, "mono16"),
        ("32FC1", 0, "32FC1"),
        ("rgb8", 5, "rgb8"),
        ("bgr8", 0, "bgr8"),
        ("mono8", 16, "mono8"),
        ("bayer_grbg8", 3, "rgb8"),
        ("bayer_bggr16", 0, "rgb16"),
    ],
)
def test_encodings(scene, tmp_path, capsys, encoding, padding, made):
    bag = write_bag(tmp_path / "in", recording(scene, encoding, 1, padding), "sqlite3")
    result = call(capsys, *command(scene, bag, tmp_path / "out", "--json"))
    assert (result.status, result.err) == (0, "")
    assert json.loads(result.out)["depth"]["median_depth_m"] == pytest.approx(2.3, abs=0.8)
    ((_, sharp),) = decoded(read(tmp_path / "out"), "/eye/deblurred/image")
    assert sharp.encoding == made
    if made in ("rgb8", "bgr8", "rgb16"):  # green is the brightest channel of the scene
        means = array_from_image(sharp).reshape(-1, 3).mean(axis=0)
        assert means[1] > means[0] > means[2]


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_compressed_images(scene, tmp_path, capsys, suffix):
    pixels = frame_pixels(scene, "bgr8", 0)
    data = compressed(pixels, suffix, 0)
    bag = write_bag(tmp_path / "in", [("/eye/image_raw/compressed", COMPRESSED, START_NS, data)])
    result = call(capsys, *command(scene, bag, tmp_path / "out"))
    assert (result.status, result.err) == (0, "")
    messages = read(tmp_path / "out")
    ((_, depth),) = decoded(messages, "/eye/depth/image")
    error = np.abs(floats(depth) - scene.depth_m) / scene.depth_m
    assert np.nanmedian(error[scene.away_from_the_edge()]) < 0.05
    ((_, sharp),) = decoded(messages, "/eye/deblurred/image")
    means = array_from_image(sharp).reshape(-1, 3).mean(axis=0)
    assert means[1] > means[0] > means[2]


@pytest.mark.parametrize(
    ("suffix", "kind", "options"),
    [
        (".png", "bayer_bggr16; png compressed ", ()),
        (".png", "bayer_bggr8; png compressed ", ()),
        (".jpg", "bayer_bggr8; jpeg compressed ", ()),
        (".png", "mono16; png compressed ", ("--bayer", "bggr")),
        ("", "mono16", ("--bayer", "bggr")),
    ],
)
def test_mosaics_give_the_same_depth_in_every_form(scene, tmp_path, capsys, suffix, kind, options):
    mosaic = frame_pixels(scene, "bayer_bggr16", 0)
    wanted = []
    if "8;" in kind:
        mosaic = np.rint(mosaic / 257).astype(np.uint8)
    encoding = f"bayer_bggr{8 * mosaic.dtype.itemsize}"
    raw = ("/eye/image_raw", IMAGE, START_NS, image(mosaic, encoding, 0))
    other = ("/eye/image_raw", IMAGE, START_NS, image(mosaic, "mono16", 0))
    if suffix:
        coded = cv2.imencode(suffix, mosaic, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].reshape(-1)
        message = STORE.types[COMPRESSED](header=header(0), format=kind, data=coded)
        data = STORE.serialize_cdr(message, COMPRESSED)
        other = ("/eye/image_raw/compressed", COMPRESSED, START_NS, data)
    for name, recorded, more in (("raw", raw, ()), ("other", other, options)):
        bag = write_bag(tmp_path / name, [recorded])
        result = call(capsys, *command(scene, bag, tmp_path / f"{name}_out", *more))
        assert result.status == 0, result.err
        messages = read(tmp_path / f"{name}_out")
        ((_, depth),) = decoded(messages, "/eye/depth/image")
        ((_, sharp),) = decoded(messages, "/eye/deblurred/image")
        wanted.append((floats(depth), array_from_image(sharp)))
    assert wanted[1][1].shape == (*mosaic.shape, 3)
    if suffix != ".jpg":
        np.testing.assert_array_equal(wanted[1][0], wanted[0][0])
        np.testing.assert_array_equal(wanted[1][1], wanted[0][1])
    else:
        np.testing.assert_allclose(wanted[1][1].mean((0, 1)), wanted[0][1].mean((0, 1)), rtol=0.02)


def test_a_damaged_jpeg_is_a_fault_of_data(scene, tmp_path, capsys):
    """It has its end marker; a camera has lost what was in the middle."""
    pytest.importorskip("numba")
    whole = compressed(frame_pixels(scene, "bgr8", 0), ".jpg", 0)
    message = STORE.deserialize_cdr(whole, COMPRESSED)
    first = len(message.data) * 2 // 5
    cut = np.concatenate([message.data[:first], message.data[first + len(message.data) // 5 :]])
    message = STORE.types[COMPRESSED](header=header(1), format=message.format, data=cut)
    damaged = STORE.serialize_cdr(message, COMPRESSED)
    topic = "/eye/image_raw/compressed"
    bag = write_bag(
        tmp_path / "in",
        [(topic, COMPRESSED, START_NS, whole), (topic, COMPRESSED, START_NS + 10**8, damaged)],
    )
    assert call(capsys, *command(scene, bag, tmp_path / "out")).status == 0
    report = json.loads((tmp_path / "out" / "report" / "report.json").read_text())
    assert report["faults"] == {"data": 1}
    assert "damaged" in report["fault_reasons"]["data"]
    assert len(decoded(read(tmp_path / "out"), "/eye/depth/image")) == 1


@pytest.mark.parametrize(
    ("storage", "mode"),
    [("mcap", CompressionMode.STORAGE), ("sqlite3", CompressionMode.MESSAGE),
     ("sqlite3", CompressionMode.FILE)],
)  # fmt: skip
def test_compressed_bags(scene, tmp_path, capsys, storage, mode):
    bag = write_bag(tmp_path / "in", recording(scene, frames=1), storage, mode)
    result = call(capsys, *command(scene, bag, tmp_path / "out", "--deblur", "none"))
    assert (result.status, result.err) == (0, "")
    assert len(decoded(read(tmp_path / "out"), "/eye/depth/image")) == 1


def test_types_that_nobody_knows_are_copied(scene, tmp_path, capsys):
    custom = {"robot_msgs/msg/Gripper": "float32 force\nuint8 fingers"}
    data = b"\x00\x01\x00\x00" + np.float32(2.5).tobytes() + b"\x03"
    messages = [*recording(scene, frames=1), ("/gripper", "robot_msgs/msg/Gripper", START_NS, data)]
    bag = write_bag(tmp_path / "in", messages, custom=custom)
    assert call(capsys, *command(scene, bag, tmp_path / "out")).status == 0
    assert ("/gripper", "robot_msgs/msg/Gripper", START_NS, data) in read(tmp_path / "out")


def test_frames_that_cannot_be_used_are_named_and_the_rest_is_done(scene, tmp_path, capsys, caplog):
    messages = recording(scene, frames=3)
    where = [index for index, message in enumerate(messages) if message[0] == "/eye/image_raw"]
    pixels = frame_pixels(scene, "mono8", 1)
    broken = {where[0]: image(pixels, "nv21", 0), where[1]: image(pixels[:64], "mono8", 1)}
    messages = [(*message[:3], broken.get(i, message[3])) for i, message in enumerate(messages)]
    messages.append(("/eye/image_raw", IMAGE, START_NS + 10**9, b"\0\1\0\0nonsense"))
    bag = write_bag(tmp_path / "in", messages)
    result = call(capsys, *command(scene, bag, tmp_path / "out", "--json"))
    assert result.status == 0
    results = json.loads(result.out)
    assert (results["frames"], results["used"]) == (4, 1)
    assert results["faults"] == {"encoding": 1, "size": 1, "message": 1}
    assert len(caplog.messages) == 3
    assert "nv21" in caplog.text
    assert sum(name == "/eye/image_raw" for name, *_ in read(tmp_path / "out")) == 4


def test_topics_are_found_or_asked_for(scene, tmp_path, capsys):
    pixels = frame_pixels(scene, "mono8", 0)
    two = [(f"/{name}/image", IMAGE, START_NS, image(pixels, "mono8", 0)) for name in ("a", "b")]
    bag = write_bag(tmp_path / "two", two)

    def error_of(source, *options):
        result = call(capsys, *command(scene, source, tmp_path / "out", *options))
        assert result.status == 1
        assert result.err.count("\n") == 1
        return result.err

    assert "--topic /a/image or /b/image" in error_of(bag)
    assert "no topic /c in it, only /a/image, /b/image" in error_of(bag, "--topic", "/c")
    other = write_bag(tmp_path / "none", recording(scene)[:1])
    assert "no images" in error_of(other)
    assert "std_msgs/msg/String" in error_of(other, "--topic", "/chatter")
    chosen = call(capsys, *command(scene, bag, tmp_path / "out", "--topic", "b/image", "--json"))
    assert json.loads(chosen.out)["outputs"]["depth"] == "/b/depth/image"
    (tmp_path / "out").rename(tmp_path / "copy")
    assert "--namespace" in error_of(tmp_path / "copy", "--topic", "b/image")
    again = command(scene, tmp_path / "copy", tmp_path / "again", "--topic", "b/image")
    assert call(capsys, *again, "--namespace", "again").status == 0
    assert decoded(read(tmp_path / "again"), "/again/depth/image")


def test_a_reference_without_a_pair_is_told(scene, tmp_path, capsys):
    messages = recording(scene, frames=2)
    shifted = [m for m in messages if m[0] != "/truth/depth"]
    late = [m for m in recording(scene, frames=9) if m[0] == "/truth/depth"][5:]
    bag = write_bag(tmp_path / "in", [*shifted, *late])
    arguments = command(scene, bag, tmp_path / "out", "--reference-depth", "/truth/depth")
    result = call(capsys, *arguments)
    assert result.status == 1
    assert "taken at its time" in result.err
    assert not (tmp_path / "out").exists()


def test_examples_of_the_help(scene, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bank.npz").symlink_to(scene.bank)
    (tmp_path / "camera.yaml").symlink_to(scene.camera)
    messages = [
        (name.replace("/truth/depth", "/ground_truth/depth"), *rest)
        for name, *rest in recording(scene, frames=2)
    ]
    mounted = transform(0, "odom", FRAME_ID, (0.0, 0.0, 0.0))
    messages.append(("/tf_static", TF, START_NS, mounted))
    write_bag(tmp_path / "recording", messages)
    shown = [line for line in examples(capsys, "bag") if "--scheduler" not in line]
    assert len(shown) == 5
    for arguments in shown:
        fewer = FEW_MOTIONS if "--motion" in arguments else ()
        result = call(capsys, *arguments, *fewer)
        assert (result.status, result.err) == (0, ""), arguments
        assert "2 of 2 frames" in result.out
    assert (tmp_path / "scored" / "report" / "report.html").is_file()


def test_the_two_pixel_method_needs_no_bank(scene, recorded, tmp_path, capsys):
    from cli_scene import camera_file

    camera = camera_file(tmp_path, mask={"name": "two_hole"})
    bag = recorded(1)
    arguments = ("bag", bag, "-o", tmp_path / "out", "--method", "two_pixel", "--camera", camera)
    result = call(capsys, *arguments, "--depth-range", 1.4, 4, "--level-count", 9, "--json")
    assert (result.status, result.err) == (0, "")
    assert json.loads(result.out)["used"] == 1


@pytest.mark.parametrize("options", [("--motion",), ("--method", "motion")])
def test_motion_is_found_as_by_depth(scene, tmp_path, capsys, options):
    settings = (
        *options,
        *FEW_MOTIONS,
        "--longest-motion-px",
        6,
        "--stride-px",
        16,
        "--unknown",
        "nearest",
        "--temporal-frames",
        0,  # as of pictures
    )
    bag = write_bag(tmp_path / "in", recording(scene, frames=2))
    sizes = ("--output-size", "full")
    arguments = command(scene, bag, tmp_path / "out", "--deblur", "cg", *sizes, *settings)
    result = call(capsys, *arguments, "--json")
    assert (result.status, result.err) == (0, "")
    assert json.loads(result.out)["outputs"]["motion"] == "/eye/depth/motion"
    messages = read(tmp_path / "out")
    found = {name: decoded(messages, f"/eye/{name}") for name in ("depth/motion", "depth/image")}
    assert [stamp_of(message) for _, message in found["depth/motion"]] == [
        START_NS + index * PERIOD_NS for index in range(2)
    ]
    assert len(decoded(messages, "/eye/deblurred/image")) == 2
    model = ("--bank", scene.bank, "--camera", scene.camera)
    assert call(capsys, "depth", *model, bag, "-o", tmp_path, *settings).status == 0
    for index in range(2):
        motion, depth = (found[name][index][1] for name in ("depth/motion", "depth/image"))
        assert (motion.encoding, motion.step) == ("32FC2", 8 * motion.width)
        px = np.frombuffer(motion.data, "<f4").reshape(motion.height, motion.width, 2)
        of_depth = np.load(tmp_path / f"in_00000{index}.motion.npy")
        np.testing.assert_array_equal(px, of_depth)
        np.testing.assert_array_equal(floats(depth), np.load(tmp_path / f"in_00000{index}.npy"))


def test_options_of_motion_that_do_not_fit_are_refused(scene, tmp_path, capsys):
    for options in (("--exposure", 0.01), ("--angular-velocity", 0, 0, 1)):
        assert call(capsys, *command(scene, "in", tmp_path / "out", *options)).status == 2
    turning = ("--motion", "--angular-velocity", 0, 0, 1)
    assert call(capsys, *command(scene, "in", tmp_path / "out", *turning)).status == 2


@pytest.mark.parametrize("options", [("--deblur-rank", 6), ("--deblur-band", "half")])
def test_without_deblurring_its_settings_are_refused(scene, tmp_path, capsys, options):
    refused = call(capsys, *command(scene, "in", tmp_path / "out", "--deblur", "none", *options))
    assert refused.status == 2 and f"--deblur none: not with {options[0]}" in refused.err


@pytest.mark.parametrize("options", [("--bank", "x.npz"), ("--camera", "x.yaml"), ()])
def test_bank_and_camera_are_required(capsys, options):
    assert call(capsys, "bag", "in", "-o", "out", *options).status == 2


def test_nothing_but_the_bag_is_left(scene, tmp_path, capsys):
    write_bag(tmp_path / "in", recording(scene, frames=1))
    before = everything(tmp_path)
    target = tmp_path / "deep" / "out"
    assert call(capsys, *command(scene, tmp_path / "in", target)).status == 0
    made = {str(path) for path in set(everything(tmp_path)) - set(before)}
    names = ("", "/metadata.yaml", "/out.mcap", "/report")
    reports = ("/report/report.html", "/report/report.json")
    assert made == {"deep", *(f"deep/out{name}" for name in (*names, *reports))}
    results = json.loads((target / "report" / "report.json").read_text())
    assert results["timing"]["times_real_time"] is None  # one frame has no rate
    assert math.isfinite(results["timing"]["seconds"])


def test_smaller_depth_is_compared_with_the_nearest_reference(scene, tmp_path, capsys):
    rough = scene.depth_m * np.random.default_rng(3).uniform(0.8, 1.2, scene.depth_m.shape)
    messages = [message for message in recording(scene, frames=1) if message[0] != "/truth/depth"]
    messages.append(("/truth/depth", IMAGE, START_NS, image(rough.astype("f4"), "32FC1", 0)))
    bag = write_bag(tmp_path / "in", messages)
    options = ("--output-size", "half", "--deblur", "none", "--reference-depth", "truth/depth")
    result = call(capsys, *command(scene, bag, tmp_path / "out", *options, "--json"))
    assert (result.status, result.err) == (0, "")
    messages = read(tmp_path / "out")
    ((_, depth),) = decoded(messages, "/eye/depth/image")
    ((_, truth),) = decoded(messages, "/truth/depth")
    # The middle of a pixel of half the size is a corner of four, all as near: OpenCV 4.6 takes the
    # first of them, later versions the last.
    reference = json.loads(result.out)["reference"]
    found = [reference[f"{name}_relative_error"] for name in ("median", "mean")]
    depth_m, corners = floats(depth), []
    for first in (0, 1):
        true_m = floats(truth)[first::2, first::2]
        both = np.isfinite(depth_m) & (true_m > 0)
        error = np.abs(depth_m[both] - true_m[both]) / true_m[both]
        corners.append([float(np.median(error)), float(error.mean())])
    assert any(found == pytest.approx(corner, rel=1e-4) for corner in corners)


@pytest.mark.parametrize("namespace", ["bad name!", "a//b", "2nd", "a/2nd", "//", "caf\u00e9"])
def test_a_namespace_that_ros_does_not_allow_is_refused(scene, tmp_path, capsys, namespace):
    arguments = ("bag", tmp_path, "-o", tmp_path / "out", "--bank", scene.bank)
    arguments += ("--camera", scene.camera, "--namespace", namespace)
    wrong_usage(call(capsys, *arguments), "bag", f"got {namespace}", "a ROS name such as")
    assert everything(tmp_path) == {}


@pytest.mark.parametrize("namespace", ["", "/", "a", "/a/b_2/", "_a"])
def test_namespaces_that_ros_allows(namespace):
    options = ("bag", "in", "-o", "out", "--bank", "b", "--camera", "c", "--namespace", namespace)
    assert parsed(*options).namespace == namespace
