"""Bags of the small scene, written with rosbags itself, and what rosbags finds in bags."""

import contextlib
import dataclasses
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from rosbags.rosbag2 import CompressionFormat, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from coded_aperture_ros.io.messages import pixels_from_frame

STORE = get_typestore(Stores.ROS2_JAZZY)
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, STRING = "sensor_msgs/msg/CameraInfo", "std_msgs/msg/String"
TF = "tf2_msgs/msg/TFMessage"
PLUGINS = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
SUFFIXES = {"mcap": ".mcap", "sqlite3": ".db3"}
START_NS, PERIOD_NS = 1_700_000_000_123_456_789, 33_333_333
# Recorded so long after the stamp.
DELAY_NS = 4_000_000
FRAME_ID = "camera_optical_frame"
FRAMES = 4


def header(index):
    stamp_ns = START_NS + index * PERIOD_NS
    stamp = STORE.types["builtin_interfaces/msg/Time"](
        sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9
    )
    return STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id=FRAME_ID)


def image(pixels, encoding, index, padding=0, **changes):
    """Return an image message; rows may be padded."""
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    message = STORE.types[IMAGE](
        header=header(index),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.reshape(-1),
    )
    return STORE.serialize_cdr(dataclasses.replace(message, **changes), IMAGE)


def compressed(pixels, suffix, index, *how):
    data = cv2.imencode(suffix, pixels, how)[1].reshape(-1)
    message = STORE.types[COMPRESSED](
        header=header(index), format=f"bgr8; {suffix[1:]} compressed bgr8", data=data
    )
    return STORE.serialize_cdr(message, COMPRESSED)


def camera_info(index, width, height, focal_length_px, roi=(0, 0, 0, 0)):
    """Return a camera model; the region has x offset, y offset, height and width."""
    k = np.array([focal_length_px, 0, width / 2 + 3, 0, focal_length_px, height / 2 - 5, 0, 0, 1])
    region = STORE.types["sensor_msgs/msg/RegionOfInterest"](*roi, False)
    message = STORE.types[CAMERA_INFO](
        header=header(index), height=height, width=width, distortion_model="plumb_bob",
        d=np.array([0.1, -0.2, 0, 0, 0.05]), k=k, r=np.eye(3).reshape(-1), p=np.zeros(12),
        binning_x=0, binning_y=0, roi=region,
    )  # fmt: skip
    return STORE.serialize_cdr(message, CAMERA_INFO)


def transform(index, parent, child, place, turn=(0.0, 0.0, 0.0, 1.0)):
    """Return a message of /tf with one transform."""
    transform = STORE.types["geometry_msgs/msg/Transform"](
        translation=STORE.types["geometry_msgs/msg/Vector3"](*place),
        rotation=STORE.types["geometry_msgs/msg/Quaternion"](*turn),
    )
    of_parent = dataclasses.replace(header(index), frame_id=parent)
    stamped = STORE.types["geometry_msgs/msg/TransformStamped"](of_parent, child, transform)
    return STORE.serialize_cdr(STORE.types[TF](transforms=[stamped]), TF)


def text(words):
    return STORE.serialize_cdr(STORE.types[STRING](data=words), STRING)


def write_bag(path, messages, storage="mcap", compression=None, custom=None):
    """Write messages (topic, type, time in ns, data) with rosbags."""
    store = STORE
    if custom:
        store = get_typestore(Stores.ROS2_JAZZY)
        for name, definition in custom.items():
            store.register(get_types_from_msg(definition, name))
    writer = Writer(path, version=9, storage_plugin=PLUGINS[storage])
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, type_name, time_ns, data in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_name, typestore=store)
            writer.write(connections[topic], time_ns, data)
    return path


@cache
def _coded(path):
    return np.load(path)


def frame_pixels(scene, encoding, index):
    """Return a noisy coded frame as an encoding stores it."""
    return _pixels(scene.coded_npy, encoding, index)


@cache
def _pixels(path, encoding, index):
    coded = _coded(path)
    noise = 0.001 * np.random.default_rng(index).standard_normal(coded.shape)
    coded = np.clip(coded + noise, 0, 1).astype(np.float32)
    grey = coded @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    return {
        "mono8": lambda: np.rint(255 * grey).astype(np.uint8),
        "mono16": lambda: np.rint(65535 * grey).astype(np.uint16),
        "32FC1": lambda: grey,
        "rgb8": lambda: np.rint(255 * coded).astype(np.uint8),
        "bgr8": lambda: np.rint(255 * coded[..., ::-1]).astype(np.uint8),
        "bayer_grbg8": lambda: pixels_from_frame(coded, encoding),
        "bayer_bggr16": lambda: pixels_from_frame(coded, encoding),
    }[encoding]()


def recording(scene, encoding="mono8", frames=FRAMES, padding=0, reference="32FC1"):
    """Return the messages of a camera, a depth camera and a chatterer."""
    messages = [("/chatter", STRING, START_NS - 1, text("begin"))]
    height, width = scene.depth_m.shape
    true = scene.depth_m.copy()
    true[:20, :30] = 0
    if reference == "16UC1":
        true = np.rint(1000 * true).astype(np.uint16)
    for index in range(frames):
        time_ns = START_NS + index * PERIOD_NS + DELAY_NS
        pixels = frame_pixels(scene, encoding, index)
        messages += [
            ("/eye/camera_info", CAMERA_INFO, time_ns, camera_info(index, width, height, 400.0)),
            ("/eye/image_raw", IMAGE, time_ns + 1, image(pixels, encoding, index, padding)),
            ("/truth/depth", IMAGE, time_ns + 2, image(true, reference, index)),
            ("/chatter", STRING, time_ns + 3, text(f"frame {index}")),
        ]
    return messages


def read(path):
    """Return all messages of a bag as rosbags reads them: topic, type, time, data."""
    with Reader(path) as reader:
        return [
            (connection.topic, connection.msgtype, time_ns, bytes(data))
            for connection, time_ns, data in reader.messages()
        ]


def decoded(messages, topic):
    """Return time and message of every one of a topic."""
    return [
        (time_ns, STORE.deserialize_cdr(data, type_name))
        for name, type_name, time_ns, data in messages
        if name == topic
    ]


def stamp_of(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def floats(message):
    """Return the pixels of a 32FC1 image."""
    assert (message.encoding, message.step) == ("32FC1", 4 * message.width)
    return np.frombuffer(message.data, "<f4").reshape(message.height, message.width)


def storage_file(folder: Path) -> Path:
    (file,) = [path for path in folder.iterdir() if path.suffix in SUFFIXES.values()]
    return file


def worker_processes(pid):
    """Return the worker processes that a program has started."""
    found = set()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it may end meanwhile
            is_child = int(stat.read_text().rpartition(")")[2].split()[1]) == pid
            if is_child and "popen_loky" in (stat.parent / "cmdline").read_text():
                found.add(int(stat.parent.name))
    return found
