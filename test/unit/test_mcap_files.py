"""MCAP files: channels of other programs, damage in the middle, attachments and metadata."""

import dataclasses
import itertools
import shutil
import struct

import numpy as np
import pytest
import yaml
from bag_scene import IMAGE, START_NS, STORE, STRING, image, storage_file, text, write_bag
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import CompressionMode

from coded_aperture_ros.bags import Bag, bag_output
from coded_aperture_ros.bags.topics import image_topic
from coded_aperture_ros.core.errors import InputError

DEFINITION = STORE.generate_msgdef(IMAGE, ros_version=2)[0].encode()
OMG = b"module sensor_msgs { module msg { struct Image { unsigned long height; }; }; };"
COUNT = 12
PIXELS = np.random.default_rng(0).integers(0, 255, (COUNT, 40, 500), np.uint8)
DATA = [bytes(image(pixels, "mono8", index)) for index, pixels in enumerate(PIXELS)]
# Message encoding, name, encoding and content of the schema; None: no schema.
FOREIGN = {
    "json": ("json", "my.Note", "jsonschema", b'{"type": "object"}'),
    "protobuf": ("protobuf", "my.Note", "protobuf", b"\n\xff\xfe\x00binary"),
    "flatbuffer": ("flatbuffer", "my.Note", "flatbuffer", b"\x80\x00bfbs"),
    "cbor": ("cbor", None),
    "none": ("json", None),
    "cdr_without_schema": ("cdr", None),
    "unnamed": ("", None),
    "msgpack": ("msgpack", "my.Note", "", b""),
    "omg": ("cdr", "my::Note", "omgidl", b"module my { struct Note { long a; }; };"),
    "ros1": ("ros1", "sensor_msgs/Image", "ros1msg", b"uint32 height"),
    "json_image": ("json", IMAGE, "jsonschema", b"{}"),
}


def write_mcap(
    path,
    foreign=(),
    *,
    camera=("cdr", IMAGE, "ros2msg", DEFINITION),
    topic="/image_raw",
    compression=CompressionType.NONE,
    extras=False,
    **options,
):
    """Write an MCAP file as other programs do; a chunk for every message of the camera."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=15_000, compression=compression, **options)
        writer.start("" if foreign else "ros2", "test")

        def channel(topic, encoding, name, *schema):
            number = 0 if name is None else writer.register_schema(name, *schema)
            return writer.register_channel(topic, encoding, number)

        ours = channel(topic, *camera)
        others = [channel(f"/{name}", *FOREIGN[name]) for name in foreign]
        if extras:
            writer.add_attachment(3, 4, "calibration.yaml", "text/yaml", b"a: 1\n")
            writer.add_metadata("operator", {"name": "Ada", "weather": "fog"})
        for index, data in enumerate(DATA):
            time_ns = START_NS + 10 * index
            writer.add_message(ours, time_ns, data, time_ns)
            for number in others:
                writer.add_message(number, time_ns + 1, b'{"a": %d}' % index, time_ns + 1)
        writer.finish()
    return path


def opened(path, *topics):
    with Bag(path) as bag:
        return [message.data for message in bag.messages(*topics)], bag.damage


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_channels_of_other_programs_do_not_get_in_the_way(tmp_path, compression):
    path = write_mcap(tmp_path / "a.mcap", FOREIGN, compression=compression)
    with Bag(path) as bag:
        assert image_topic(bag.topics, None).name == "/image_raw"
        assert [message.data for message in bag.messages("/image_raw")] == DATA
        found = list(bag.messages())
        assert len(found) == COUNT * (1 + len(FOREIGN))
        assert [message.time_ns for message in found] == sorted(m.time_ns for m in found)
        assert {topic for topic, of in bag.topics.items() if of.foreign} == {
            f"/{name}" for name in FOREIGN
        }
        assert {of.count for of in bag.topics.values()} == {COUNT}
        assert (bag.damage, bag.left_out) == ("", [])


@pytest.mark.parametrize("name", FOREIGN)
def test_images_that_are_not_of_ros_2_are_refused_by_name(tmp_path, name):
    path = write_mcap(tmp_path / "a.mcap", camera=FOREIGN[name])
    if FOREIGN[name][0] == "ros1":
        with pytest.raises(InputError, match=r"of ROS 1.*rosbags-convert"):
            Bag(path)
        return
    with Bag(path) as bag:
        for wanted in (None, "/image_raw"):
            with pytest.raises(InputError, match=r"/image_raw") as refused:
                image_topic(bag.topics, wanted)
            assert f"({FOREIGN[name][0] or 'no encoding'})" in str(refused.value)


@pytest.mark.parametrize("name", ["sensor_msgs::msg::Image", "sensor_msgs::msg::dds_::Image_"])
def test_images_described_by_the_idl_of_the_omg_are_images(tmp_path, name):
    path = write_mcap(tmp_path / "a.mcap", camera=("cdr", name, "omgidl", OMG))
    with Bag(path) as bag:
        assert image_topic(bag.topics, None).type_name == IMAGE
        assert [message.data for message in bag.messages()] == DATA


def test_messages_of_other_programs_on_the_topic_of_the_camera_are_left_out(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", ("json",), topic="/json")
    with Bag(path) as bag:
        assert [message.data for message in bag.messages()] == DATA
        assert list(map(str, bag.left_out)) == ["/json of my.Note (json)"]


def copied(path, target):
    """Copy a bag; return what mcap's own reader finds in the copy."""
    with Bag(path) as bag, bag_output(target, bag.storage) as writer:
        for topic in bag.topics.values():
            writer.add_topic(topic)
        for supplement in bag.supplements():
            writer.add_supplement(supplement)
        for message in bag.messages():
            writer.write(message.topic, message.time_ns, message.data)
    return storage_file(target)


def facts(path):
    """Channels, messages, attachments and metadata of an MCAP file."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages = [
            (
                channel.topic,
                channel.message_encoding,
                channel.topic != "/image_raw" and schema and dataclasses.astuple(schema)[1:],
                message.log_time,
                message.data,
            )
            for schema, channel, message in reader.iter_messages()
        ]
        attachments = list(reader.iter_attachments())
        metadata = [each for each in reader.iter_metadata() if each.name != "rosbag2"]
        statistics = reader.get_summary().statistics
        assert statistics.message_count == len(messages)
        assert set(statistics.channel_message_counts.values()) == {COUNT}
        counts = statistics.attachment_count, statistics.metadata_count - len(metadata)
        return messages, attachments, metadata, counts


def test_channels_attachments_and_metadata_are_copied_as_they_are(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", FOREIGN, extras=True)
    copy = copied(path, tmp_path / "copy")
    messages, attachments, metadata, _ = facts(path)
    assert len(attachments) == len(metadata) == 1
    assert facts(copy) == (messages, attachments, metadata, (1, 1))
    again = copied(copy, tmp_path / "again")
    assert facts(again) == facts(copy)
    # rosbag2 refuses bags of several encodings.
    layout = yaml.safe_load((tmp_path / "copy" / "metadata.yaml").read_text())
    (topic,) = layout["rosbag2_bagfile_information"]["topics_with_message_count"]
    assert topic["topic_metadata"]["name"] == "/image_raw"


def test_a_definition_that_nobody_can_read_is_copied(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", camera=("cdr", "my/msg/Odd", "ros2msg", b"{"))
    with copied(path, tmp_path / "copy").open("rb") as file:
        (schema,) = make_reader(file).get_summary().schemas.values()
    assert (schema.name, schema.data) == ("my/msg/Odd", b"{")


COMPRESSIONS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4}
COMPRESSIONS["zstd"] = CompressionType.ZSTD


def chunk_starts(data):
    """Positions of the chunks in an MCAP file."""
    position, found = 8, []
    while position < len(data) - 8:
        kind, length = struct.unpack_from("<BQ", data, position)
        if kind == 0x06:
            found.append(position)
        position += 9 + length
    return found


def damaged_pixels(data, start):
    data[start + 9000 : start + 9050] = b"\xff" * 50


def damaged_header(data, start):
    data[start + 9 : start + 60] = b"\xff" * 51


def damaged_length(data, start):
    data[start : start + 9] = b"\xff" * 9


def shorter_length(data, start):
    data[start + 1 : start + 3] = b"\x05\x01"


def longer_length(data, start):
    """It ends in the middle of the chunk after the next one."""
    data[start + 1 : start + 9] = struct.pack("<Q", 50_000)


def lost_kind(data, start):
    data[start] = 0x30


def lost_sector(data, start):
    data[start : start + 4096] = bytes(4096)


def lost_begin(data, start):
    data[: start + 100] = bytes(start + 100)


DAMAGES = (
    damaged_pixels,
    damaged_header,
    damaged_length,
    shorter_length,
    longer_length,
    lost_kind,
    lost_sector,
)


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize(
    ("damage", "number"), [*itertools.product(DAMAGES, (0, 5)), (lost_begin, 0)]
)
@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE])
def test_what_is_behind_a_damaged_chunk_is_read(tmp_path, compression, damage, number, index):
    options = {"index_types": index}
    if index is IndexType.NONE:
        options |= {"use_statistics": False, "use_summary_offsets": False}
    path = write_mcap(tmp_path / "a.mcap", compression=COMPRESSIONS[compression], **options)
    data = bytearray(path.read_bytes())
    starts = chunk_starts(data)
    assert len(starts) == COUNT
    damage(data, starts[number])
    path.write_bytes(data)
    found, words = opened(path, "/image_raw")
    assert set(found) <= set(DATA)
    # Where only the record's length is wrong, the chunk says its own.
    lost = [] if damage is longer_length else [DATA[number]]
    assert [each for each in DATA if each not in found] == lost
    assert found == [each for each in DATA if each in found]
    assert "a.mcap" in words and "damaged" in words
    assert "cut off" not in words


@pytest.mark.parametrize("damage", [damaged_header, damaged_length, lost_kind, lost_sector])
def test_what_is_behind_a_damaged_message_in_no_chunk_is_read(tmp_path, damage):
    path = write_mcap(tmp_path / "a.mcap", use_chunking=False)
    data = bytearray(path.read_bytes())
    damage(data, data.index(DATA[5]) - 31)
    path.write_bytes(data)
    found, words = opened(path)
    assert found == [*DATA[:5], *DATA[6:]]
    assert "a.mcap: " in words and "left out" in words


def test_messages_in_no_chunk_come_in_the_order_of_their_times(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start("ros2", "test")
        schema = writer.register_schema(IMAGE, "ros2msg", DEFINITION)
        channel = writer.register_channel("/image_raw", "cdr", schema)
        for index in (2, 0, 1):
            writer.add_message(channel, index, DATA[index], index)
        writer.finish()
    assert opened(path) == (DATA[:3], "")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize(
    ("name", "reads"),
    [("bag_1", True), ("bag_10", True), ("other", False), ("bag_copy", False), ("other_1", False)],
)
def test_a_file_that_the_metadata_does_not_list_is_read_or_named(tmp_path, storage, name, reads):
    bag = write_bag(tmp_path / "bag", [("/a", STRING, 1, text("one"))], storage)
    other = write_bag(tmp_path / "more", [("/a", STRING, 2, text("two"))], storage)
    added = f"{name}{storage_file(other).suffix}"
    shutil.copy(storage_file(other), bag / added)
    found, damage = opened(bag)
    assert found == [text("one"), text("two")][: 1 + reads]
    assert damage == f"{added} is not in metadata.yaml, {'but read' if reads else 'and left out'}"


def test_a_file_of_another_storage_is_named(tmp_path):
    bag = write_bag(tmp_path / "bag", [("/a", STRING, 1, text("one"))], "sqlite3")
    other = write_bag(tmp_path / "more", [("/a", STRING, 2, text("two"))])
    shutil.copy(storage_file(other), bag / "bag_1.mcap")
    assert opened(bag) == ([text("one")], "bag_1.mcap is not in metadata.yaml, and left out")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_bags_are_read_with_and_without_damage(tmp_path, storage, mode):
    messages = [("/image_raw", IMAGE, START_NS + i, data) for i, data in enumerate(DATA)]
    bag = write_bag(tmp_path / "bag", messages, storage, mode)
    assert opened(bag) == (DATA, "")
    (file,) = (each for each in bag.iterdir() if each.name != "metadata.yaml")
    file.write_bytes(file.read_bytes()[: int(0.7 * file.stat().st_size)])
    found, damage = opened(bag)
    assert found == DATA[: len(found)]
    assert len(found) >= 4
    assert "bag." in damage


def test_files_that_the_metadata_lists_and_that_are_missing_are_named(tmp_path):
    bag = write_bag(tmp_path / "bag", [("/a", STRING, 1, text("one"))])
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- bag.mcap", "- bag.mcap\n  - bag_1.mcap"))
    found, damage = opened(bag)
    assert (len(found), damage) == (1, "bag_1.mcap is missing")
    metadata.write_text("{nonsense")
    assert opened(bag)[1] == "metadata.yaml cannot be read"
    shutil.copy(bag / "bag.mcap", bag / "bag.db3")
    assert "bag.db3 is left out" in opened(bag)[1]
