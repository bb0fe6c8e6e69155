"""All frames of a bag through depth and deblurring into another bag."""

import dataclasses
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from coded_aperture_ros.bags.ordered import in_order
from coded_aperture_ros.bags.processes import Submit, Wait
from coded_aperture_ros.bags.work import FrameResult
from coded_aperture_ros.core.threads import processors
from coded_aperture_ros.io.bags.conversion import CAMERA_INFO, IMAGE, Conversion
from coded_aperture_ros.io.bags.reading import Bag
from coded_aperture_ros.io.bags.recorded import Recorded, Topic
from coded_aperture_ros.io.bags.topics import Outputs
from coded_aperture_ros.io.bags.writing import BagWriter
from coded_aperture_ros.io.messages import MessageError
from coded_aperture_ros.optics import Camera

# Messages that are copied wait for the next frame, but not more of them than this.
_WAITING_BYTES = 16 * 2**20
# Frames between reading and writing, for each processor.
_AHEAD = 3


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """A frame of the bag, and what was made of it.

    Attributes
    ----------
    index : int
        In its topic.
    recorded : Recorded
        Its message.
    result : FrameResult
    """

    index: int
    recorded: Recorded
    result: FrameResult


@dataclasses.dataclass(frozen=True, eq=False)
class _Batch:
    """Messages in the order of the bag.

    Attributes
    ----------
    copies : tuple of Recorded
    index : int or None
        Of the frame that the last of them is, if it is one.
    info : sensor_msgs/CameraInfo
        The camera model of that time.
    """

    copies: tuple[Recorded, ...]
    index: int | None
    info: Any


class BagPipeline:
    """Reads a bag, has the frames of one topic worked on, and writes another bag.

    Parameters
    ----------
    image : Topic
        Of the frames.
    outputs : Outputs
    camera : Camera
    map_size : (int, int)
        Rows and columns of the depth images.
    deblurs : bool
        Whether all-in-focus frames are made.

    Attributes
    ----------
    faults : Counter of str
        Frames that could not be used, by the reason in a word.
    reasons : dict of str to str
        The first of each in a line.
    """

    def __init__(
        self,
        image: Topic,
        outputs: Outputs,
        camera: Camera,
        map_size: tuple[int, int],
        deblurs: bool,
    ) -> None:
        self._image, self._outputs, self._deblurs = image, outputs, deblurs
        self._size = camera.image_height, camera.image_width
        self._map_size = map_size
        self._convert = Conversion()
        # The camera file's, until the bag has one.
        self._info = self._convert.info_of(camera.intrinsics)
        self.faults: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}

    def topics(self) -> list[Topic]:
        """Return the topics of the results."""
        names = self._outputs
        kinds = {names.depth: IMAGE, names.confidence: IMAGE, names.depth_info: CAMERA_INFO}
        if self._deblurs:
            kinds |= {names.deblurred: IMAGE, names.deblurred_info: CAMERA_INFO}
        return [self._convert.topic(name, kind) for name, kind in kinds.items()]

    def prepare(self) -> None:
        """Have made what reads and writes the messages: with the first ones it takes 0.1 s."""
        convert, info = self._convert, self._info
        convert.camera_info(convert.scaled_camera_info(info, self._map_size, info.header))
        convert.depth(convert.image(np.zeros((1, 1), np.float32), "32FC1", info.header))

    def run(
        self, bag: Bag, writer: BagWriter, submit: Submit, info_topic: str | None = None
    ) -> Iterator[tuple[tuple[Recorded, ...], Frame | None]]:
        """Copy all messages, and write the results of every frame right behind it.

        Parameters
        ----------
        bag : Bag
        writer : BagWriter
            With the topics of the bag and the results.
        submit : callable
            See `working`.
        info_topic : str, optional
            Of the camera models in the bag.

        Yields
        ------
        copies : tuple of Recorded
            Messages that were copied.
        frame : Frame or None
            The last of them.
        """

        def begin(batch: _Batch) -> Wait | None:
            return None if batch.index is None else submit(batch.copies[-1].data)

        batches = self._batches(bag, info_topic)
        for batch, result in in_order(begin, batches, _AHEAD * processors()):
            for message in batch.copies:
                writer.write(message.topic, message.time_ns, message.data)
            if result is None or batch.index is None:
                yield batch.copies, None
                continue
            frame = Frame(batch.index, batch.copies[-1], result)
            for topic, data in self._messages(result, batch.info):
                writer.write(topic, frame.recorded.time_ns, data)
            if result.fault:
                self.faults[result.fault] += 1
                self.reasons.setdefault(result.fault, result.reason)
            yield batch.copies, frame

    def _batches(self, bag: Bag, info_topic: str | None) -> Iterator[_Batch]:
        copies: list[Recorded] = []
        waiting, index = 0, 0
        for message in bag.messages():
            copies.append(message)
            waiting += len(message.data)
            if message.topic == info_topic:
                self._take_info(message.data)
            if message.topic == self._image.name:
                yield _Batch(tuple(copies), index, self._info)
                index += 1
            elif waiting > _WAITING_BYTES:
                yield _Batch(tuple(copies), None, self._info)
            else:
                continue
            copies, waiting = [], 0
        yield _Batch(tuple(copies), None, self._info)

    def _messages(self, result: FrameResult, info: Any) -> Iterator[tuple[str, memoryview]]:
        """Yield the messages that say what was made of a frame, and their topics."""
        names, convert, header = self._outputs, self._convert, result.header
        if result.depth_m is not None and result.confidence is not None:
            yield names.depth, convert.image(result.depth_m, "32FC1", header)
            yield names.confidence, convert.image(result.confidence, "32FC1", header)
            yield names.depth_info, convert.scaled_camera_info(info, self._map_size, header)
        if result.sharp is not None:
            yield names.deblurred, convert.image(result.sharp, result.encoding, header)
            yield names.deblurred_info, convert.scaled_camera_info(info, self._size, header)

    def _take_info(self, data: bytes) -> None:
        """Take a camera model of the bag, unless it is empty or of another size."""
        try:
            info = self._convert.camera_info(data)
        except MessageError:
            return
        if (info.height, info.width) == self._size and info.k[0] > 0 and info.k[4] > 0:
            self._info = info
