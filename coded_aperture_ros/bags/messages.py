"""Messages of a bag, frame by frame, and messages of the results."""

import dataclasses
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np

from coded_aperture_ros.bags import codec
from coded_aperture_ros.bags.contents import BagMessage, Topic
from coded_aperture_ros.bags.frames import ProcessedFrame
from coded_aperture_ros.bags.reading import Bag
from coded_aperture_ros.bags.topics import Outputs
from coded_aperture_ros.frames import View
from coded_aperture_ros.io.messages import MessageError, view_from_camera_info
from coded_aperture_ros.optics import Camera

# Messages that are copied wait for the next frame, but not more of them than this.
_WAITING_BYTES = 16 * 2**20


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Messages in the order of the bag, up to a frame.

    Attributes
    ----------
    copies : tuple of BagMessage
    index : int or None
        Of the frame in its topic, which is the last of the messages; None: none of them is one.
    info : message
        Camera model of that time.
    """

    copies: tuple[BagMessage, ...]
    index: int | None
    info: Any

    @property
    def frame(self) -> bytes | None:
        """Message of the frame, if there is one."""
        return None if self.index is None else self.copies[-1].data


def batches(
    bag: Bag, image_topic: str, info_topic: str | None, camera: Camera, view: View
) -> Iterator[Batch]:
    """Yield all messages of a bag, each time up to and with a frame.

    Parameters
    ----------
    bag : Bag
    image_topic, info_topic : str
        Of the frames and, if there is one, of their camera models.
    camera : Camera
        Its model is valid until the bag has one.
    view : View
        What the frames show of the camera's view.
    """
    info = codec.camera_info_message(camera.intrinsics.for_view(view))
    copies: list[BagMessage] = []
    waiting = 0
    frames = 0
    for message in bag.messages():
        copies.append(message)
        waiting += len(message.data)
        if message.topic == info_topic:
            info = _usable_info(message.data, view, camera) or info
        is_frame = message.topic == image_topic
        if is_frame or waiting > _WAITING_BYTES:
            yield Batch(tuple(copies), frames if is_frame else None, info)
            copies = []
            waiting = 0
            frames += is_frame
    yield Batch(tuple(copies), None, info)


def first_info(bag: Bag, topic: str | None) -> Any:
    """First camera model of a topic that has a calibration; None if there is none."""
    for message in () if topic is None else bag.messages(topic):
        with suppress(MessageError):
            info = codec.read_camera_info(message.data)
            if min(info.k[0], info.k[4]) > 0:
                return info
    return None


def _usable_info(data: bytes, view: View, camera: Camera) -> Any:
    """Camera model of a message; None if it is empty or not of the frames."""
    with suppress(MessageError):
        info = codec.read_camera_info(data)
        if view_from_camera_info(info, view.width, view.height, camera) is not None:
            return info
    return None


def result_topics(outputs: Outputs, deblurs: bool) -> list[Topic]:
    """Topics of the results, but for those of layers."""
    kinds = dict.fromkeys((outputs.depth, outputs.confidence, outputs.std_dev), codec.IMAGE)
    kinds[outputs.depth_info] = codec.CAMERA_INFO
    if deblurs:
        kinds |= {outputs.deblurred: codec.IMAGE, outputs.deblurred_info: codec.CAMERA_INFO}
    return [codec.new_topic(name, kind) for name, kind in kinds.items()]


def result_messages(
    result: ProcessedFrame, info: Any, outputs: Outputs
) -> Iterator[tuple[str, memoryview]]:
    """Yield topic and data of the messages with the results of a frame.

    `info` is the camera model of the frame's time.
    """
    header = result.header
    if (maps := result.maps) is not None:
        yield outputs.depth, codec.image_data(maps.depth_m, "32FC1", header)
        yield outputs.confidence, codec.image_data(maps.confidence, "32FC1", header)
        yield outputs.std_dev, codec.image_data(maps.std_dev_m, "32FC1", header)
        rows, columns = maps.depth_m.shape
        yield outputs.depth_info, codec.camera_info_data(info, (rows, columns), header)
        for name, layer in maps.layers.items():
            yield outputs.layers[name], codec.image_data(layer.values, layer.spec.encoding, header)
    if result.sharp is not None:
        rows, columns = result.sharp.shape[:2]
        yield outputs.deblurred, codec.image_data(result.sharp, result.encoding, header)
        yield outputs.deblurred_info, codec.camera_info_data(info, (rows, columns), header)


def warm_up(camera: Camera) -> None:
    """Prepare reading and writing of messages, which takes 0.1 s with the first ones."""
    info = codec.camera_info_message(camera.intrinsics)
    codec.read_camera_info(codec.camera_info_data(info, (1, 1), info.header))
    codec.read_depth_image(codec.image_data(np.zeros((1, 1), np.float32), "32FC1", info.header))
