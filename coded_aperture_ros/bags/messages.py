"""Messages of a bag, frame by frame, and messages of the results."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from coded_aperture_ros.bags import codec
from coded_aperture_ros.bags.camera_infos import with_infos
from coded_aperture_ros.bags.contents import BagMessage, Topic
from coded_aperture_ros.bags.frames import ProcessedFrame
from coded_aperture_ros.bags.reading import Bag
from coded_aperture_ros.bags.topics import Outputs
from coded_aperture_ros.depth.core_maps import CONFIDENCE, DEPTH, STD_DEV
from coded_aperture_ros.depth.points import points_of_depth
from coded_aperture_ros.frames import View
from coded_aperture_ros.io.messages import (
    choose_camera_info,
    region_matrices,
    view_from_camera_info,
)
from coded_aperture_ros.optics import Camera
from coded_aperture_ros.optics.distortion import pixel_rays

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
        Camera model of the frame.
    moved : str
        Why the frame cannot be used, where it shows another part of the view than the others.
    """

    copies: tuple[BagMessage, ...]
    index: int | None
    info: Any
    moved: str = ""

    @property
    def frame(self) -> bytes | None:
        """Message of the frame, if there is one that can be used."""
        return None if self.index is None or self.moved else self.copies[-1].data


@dataclasses.dataclass(frozen=True, eq=False)
class FrameViews:
    """What is expected of the frames' camera models.

    Attributes
    ----------
    camera : Camera
        Of the whole view. Its model takes the place of one that is missing or refused.
    view : View
        What the frames show of it.
    by_place : bool
        Whether depth depends on where in the view a frame is, not only on its scale.
    first_info : message or None
        Model until one has come; see `first_info`.
    """

    camera: Camera
    view: View
    by_place: bool = False
    first_info: Any = None

    @property
    def own_info(self) -> Any:
        """Message with the camera's own model of the frames."""
        return codec.camera_info_message(self.camera.intrinsics.for_view(self.view))

    def fault_of(self, info: Any) -> str:
        """Why a frame with a camera model shows another part of the view; empty if it does not."""
        view = self.view
        found = view_from_camera_info(info, view.width, view.height, self.camera)
        if found is None:
            return ""
        scaled = (found.whole_width, found.whole_height) != (view.whole_width, view.whole_height)
        if scaled or (self.by_place and (found.left, found.top) != (view.left, view.top)):
            return (
                f"camera_info says another region or binning ({_place(found)}) than that of the "
                f"first frame ({_place(view)}): convert a bag in which they do not change"
            )
        return ""


def batches(
    bag: Bag,
    image_topic: str,
    info_topic: str | None,
    views: FrameViews,
    refuse: Callable[[str], None] = lambda reason: None,
) -> Iterator[Batch]:
    """Yield all messages of a bag, each time up to and with a frame.

    Parameters
    ----------
    bag : Bag
    image_topic, info_topic : str
        Of the frames and, if there is one, of their camera models.
    views : FrameViews
    refuse : callable, optional
        Called with the reason why a camera model is not used, in a line.
    """
    own = views.own_info
    size = views.view.width, views.view.height
    copies: list[BagMessage] = []
    waiting = 0
    frames = 0
    messages = with_infos(bag.messages(), image_topic, info_topic, views.first_info, refuse)
    for message, found in messages:
        copies.append(message)
        waiting += len(message.data)
        is_frame = message.topic == image_topic
        if is_frame or waiting > _WAITING_BYTES:
            info, moved = own, ""
            if found is not None and is_frame:
                moved = views.fault_of(found)
                chosen, reason = choose_camera_info(found, *size, views.camera)
                if reason and not moved:
                    refuse(f"{reason}: writing that of the camera file")
                info = own if moved or chosen is None else chosen
            yield Batch(tuple(copies), frames if is_frame else None, info, moved)
            copies = []
            waiting = 0
            frames += is_frame
    yield Batch(tuple(copies), None, own)


def _place(view: View) -> str:
    whole = f"{view.whole_width}x{view.whole_height}"
    return f"{view.width}x{view.height} at {view.left:g}, {view.top:g} of {whole}"


def result_topics(outputs: Outputs, deblurs: bool, points: bool = False) -> list[Topic]:
    """Topics of the results, but for those of layers."""
    kinds = dict.fromkeys((outputs.depth, outputs.confidence, outputs.std_dev), codec.IMAGE)
    kinds[outputs.depth_info] = codec.CAMERA_INFO
    if deblurs:
        kinds |= {outputs.deblurred: codec.IMAGE, outputs.deblurred_info: codec.CAMERA_INFO}
    if points:
        kinds[outputs.points] = codec.POINTS
    return [codec.new_topic(name, kind) for name, kind in kinds.items()]


def result_messages(
    result: ProcessedFrame, info: Any, outputs: Outputs
) -> Iterator[tuple[str, memoryview]]:
    """Yield topic and data of the messages with the results of a frame.

    `info` is the camera model of the frame's time.
    """
    header = result.header
    if (maps := result.maps) is not None:
        for topic, values, spec in (
            (outputs.depth, maps.depth_m, DEPTH),
            (outputs.confidence, maps.confidence, CONFIDENCE),
            (outputs.std_dev, maps.std_dev_m, STD_DEV),
        ):
            yield topic, codec.image_data(values, spec.encoding, header)
        rows, columns = maps.depth_m.shape
        if maps.colours is not None:
            k, _ = region_matrices(info, columns, rows)
            rays = pixel_rays(info.distortion_model, tuple(k), tuple(info.d), rows, columns)
            points = points_of_depth(
                maps.depth_m, maps.confidence, maps.std_dev_m, maps.colours, rays
            )
            yield outputs.points, codec.cloud_data(points, header)
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
    image = codec.image_data(np.zeros((1, 1), np.float32), DEPTH.encoding, info.header)
    codec.read_depth_image(image)
