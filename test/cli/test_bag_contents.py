"""Bags with what is not of ROS 2, references without stamps, and inputs without depth."""

import json
import sqlite3

import cv2
import numpy as np
import pytest
from bag_scene import (
    IMAGE,
    PERIOD_NS,
    START_NS,
    frame_pixels,
    image,
    recording,
    storage_file,
    write_bag,
)
from cli_scene import call
from mcap.reader import make_reader
from mcap.writer import Writer

STAMP = slice(4, 12)


def command(scene, sources, target, *options):
    model = ("--bank", scene.bank, "--camera", scene.camera, "--deblur", "none")
    sources = sources if isinstance(sources, list) else [sources]
    return ("bag", *sources, "-o", target, *model, "--temporal-frames", 0, *options)


def mixed(scene, path, others):
    """MCAP file of the camera's frames and messages of other programs, as those write it."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "test")
        ours = writer.register_channel(
            "/eye/image_raw", "cdr", writer.register_schema(IMAGE, "ros2msg", b"")
        )
        numbers = [
            writer.register_channel(
                name, encoding, writer.register_schema("my.Note", schema, data) if schema else 0
            )
            for name, encoding, schema, data in others
        ]
        writer.add_attachment(0, 0, "calibration.yaml", "text/yaml", b"a: 1")
        writer.add_metadata("operator", {"name": "Ada"})
        for index in range(2):
            time_ns = START_NS + index * PERIOD_NS
            data = bytes(image(frame_pixels(scene, "mono8", index), "mono8", index))
            writer.add_message(ours, time_ns, data, time_ns)
            for number in numbers:
                writer.add_message(number, time_ns + 1, b'{"a": 1}', time_ns + 1)
        writer.finish()
    return path


def test_messages_of_other_programs_are_in_the_new_bag(scene, tmp_path, capsys):
    others = [
        ("/notes", "json", "jsonschema", b"{}"),
        ("/boxes", "protobuf", "protobuf", b"\xff\x00"),
        ("/plain", "json", "", b""),
    ]
    bag = mixed(scene, tmp_path / "in.mcap", others)
    result = call(capsys, *command(scene, bag, tmp_path / "out"))
    assert (result.status, result.err) == (0, "")
    with storage_file(tmp_path / "out").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = {
            (channel.topic, channel.message_encoding, schema and (schema.encoding, schema.data))
            for schema, channel, _ in reader.iter_messages([name for name, *_ in others])
        }
        assert found == {
            (name, encoding, (schema, data) if schema else None)
            for name, encoding, schema, data in others
        }
        assert [each.name for each in reader.iter_attachments()] == ["calibration.yaml"]
        assert {each.name for each in reader.iter_metadata()} == {"operator", "rosbag2"}
        depth = list(reader.iter_messages(["/eye/depth/image"]))
        assert len(depth) == 2


@pytest.mark.parametrize("topic", ["/notes", "/eye/notes"])
def test_a_camera_that_is_not_of_ros_2_is_refused_by_name(scene, tmp_path, capsys, topic):
    bag = mixed(scene, tmp_path / "in.mcap", [(topic, "json", "jsonschema", b"{}")])
    result = call(capsys, *command(scene, bag, tmp_path / "out", "--topic", topic))
    assert result.status == 1
    assert f"topic {topic} is of my.Note (json), expected sensor_msgs/msg/Image" in result.err
    assert result.err.count("\n") == 1


@pytest.mark.slow
def test_what_an_sqlite_file_cannot_take_is_left_out_by_name(scene, tmp_path, capsys, caplog):
    bag = write_bag(tmp_path / "in", recording(scene, frames=1), "sqlite3")
    with sqlite3.connect(storage_file(bag)) as database:
        database.execute("UPDATE topics SET serialization_format = 'json' WHERE name = '/chatter'")
    result = call(capsys, *command(scene, bag, tmp_path / "out", "--json"))
    assert result.status == 0
    assert json.loads(result.out)["left_out"] == ["/chatter of std_msgs/msg/String (json)"]
    assert "left out of the new bag: /chatter of std_msgs/msg/String (json)" in caplog.text
    assert "Not in the new bag: /chatter" in (tmp_path / "out/report/report.html").read_text()


@pytest.mark.parametrize("stamped", [True, False])
def test_frames_are_compared_with_their_own_reference(scene, tmp_path, capsys, caplog, stamped):
    """Each frame's reference is wrong by another factor, so that it is seen which one is used."""
    factors = (1.0, 1.2, 1.5, 2.0)
    messages = []
    for index, factor in enumerate(factors):
        time_ns = START_NS + index * PERIOD_NS
        for topic, pixels, encoding in (
            ("/eye/image_raw", frame_pixels(scene, "mono8", index), "mono8"),
            ("/truth/depth", (factor * scene.depth_m).astype(np.float32), "32FC1"),
        ):
            data = bytearray(image(pixels, encoding, index))
            if not stamped:
                data[STAMP] = bytes(8)
            messages.append((topic, IMAGE, time_ns + (topic == "/truth/depth"), bytes(data)))
    bag = write_bag(tmp_path / "in", messages)
    options = ("--reference-depth", "/truth/depth", "--json")
    result = call(capsys, *command(scene, bag, tmp_path / "out", *options))
    assert result.status == 0
    report = json.loads((tmp_path / "out/report/report.json").read_text())
    errors = [row["median_relative_error"] for row in report["series"]]
    assert errors == pytest.approx([1 - 1 / factor for factor in factors], abs=0.05)
    reference = report["reference"]
    names = ("paired_by_stamp", "paired_by_recording")
    assert [reference[name] for name in names] == ([4, 0] if stamped else [0, 4])
    assert ("recorded nearest to them" in caplog.text) is not stamped
    page = (tmp_path / "out/report/report.html").read_text()
    assert ("by the times of recording" in page) is not stamped


def dark_messages(frames):
    pixels = np.zeros((128, 176), np.uint8)
    return [
        ("/eye/image_raw", IMAGE, START_NS + i * PERIOD_NS, image(pixels, "mono8", i))
        for i in range(frames)
    ]


def test_a_bag_without_depth_is_an_error(scene, tmp_path, capsys, caplog):
    bag = write_bag(tmp_path / "dark", dark_messages(2))
    line = f"{bag}: no frame has depth: too dark, saturated, or without texture"
    assert call(capsys, *command(scene, bag, tmp_path / "out")).status == 1
    assert caplog.messages[-1] == line
    assert "No frame has depth" in (tmp_path / "out/report/report.html").read_text()
    good = write_bag(tmp_path / "good", recording(scene, frames=2))
    for _ in range(2):  # the second time all bags are complete
        caplog.clear()
        result = call(capsys, *command(scene, [good, bag], tmp_path / "all"))
        assert result.status == 1
        assert caplog.messages[-1:] == [line]
        assert "2 bags" in result.out


@pytest.mark.parametrize("kind", ["picture", "pictures", "folder", "bag"])
def test_inputs_without_depth_are_an_error(scene, tmp_path, capsys, kind):
    pixels = np.zeros((128, 176), np.uint8)
    folder = tmp_path / "dark"
    folder.mkdir()
    for name in ("a", "b"):
        cv2.imwrite(str(folder / f"{name}.png"), pixels)
    inputs = {
        "picture": (folder / "a.png",),
        "pictures": (folder / "a.png", scene.coded_png, folder / "b.png"),
        "folder": (folder, scene.coded_png),
    }
    inputs["bag"] = (write_bag(tmp_path / "in", dark_messages(2)),)
    without = [path for path in inputs[kind] if path != scene.coded_png]
    result = call(capsys, "depth", "--bank", scene.bank, *inputs[kind], "-o", tmp_path / "out")
    assert result.status == 1
    reason = "no frame has depth: too dark, saturated, or without texture"
    assert result.err.splitlines()[-len(without) :] == [
        f"coded_aperture: error: {path}: {reason}" for path in without
    ]
    # What is known is written all the same.
    assert (
        len(list((tmp_path / "out").glob("*.confidence.npy")))
        == {"picture": 1, "pictures": 3, "folder": 3, "bag": 2}[kind]
    )


@pytest.mark.parametrize("unit", [1000, 5000])
def test_a_depth_map_in_place_of_a_frame_is_called_one(scene, tmp_path, capsys, unit):
    rows, columns = np.mgrid[:128, :176]
    wall_m = 2.0 + 0.5 * np.sin(columns / 40) + rows / 200
    wall_m[30:80, 40:90] = 1.5
    wall_m[60:110, 70:150] = 1.8
    cv2.imwrite(str(tmp_path / "depth.png"), np.rint(unit * wall_m).astype(np.uint16))
    result = call(
        capsys, "depth", "--bank", scene.bank, tmp_path / "depth.png", "-o", tmp_path / "out.npy"
    )
    assert result.status == 1
    assert "a depth map, which no camera takes: give the coded frame" in result.err
    assert "compressed" not in result.out + result.err
