"""All frames of a bag through depth and deblurring, in a pipeline of threads."""

import dataclasses
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bags.conversion import CAMERA_INFO, IMAGE, Conversion, Picture
from coded_aperture_ros.bags.ordered import in_order
from coded_aperture_ros.bags.reading import Bag, Recorded, Topic
from coded_aperture_ros.bags.topics import Outputs
from coded_aperture_ros.bags.writing import BagWriter
from coded_aperture_ros.deblur import Deblurrer
from coded_aperture_ros.depth import DepthEstimate, DepthEstimator
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.evaluation.speed.machine import opencv_threads
from coded_aperture_ros.images import Gamma
from coded_aperture_ros.messages import MessageError, frame_from_pixels, pixels_from_frame
from coded_aperture_ros.optics import Camera

# Messages that are copied wait for the next frame, but not more of them than this.
_WAITING_BYTES = 16 * 2**20
# Frames between reading and writing, for each thread of a stage.
_AHEAD = 2


@dataclasses.dataclass(frozen=True, eq=False)
class FrameResult:
    """What was made of a frame; also of one that could not be used.

    Attributes
    ----------
    index : int
        Of the frame in its topic.
    time_ns : int
        When it was recorded.
    fault : str
        Why nothing was made of it, in a word; empty if all is well.
    picture : Picture or None
    frame : ndarray or None
        float32, linear light.
    estimate : DepthEstimate or None
    sharp : ndarray or None
        All in focus, as stored; None if that was not wanted.
    seconds : dict of str to float
        What `decode`, `depth` and `deblur` took.
    messages : tuple of (topic, data)
        To be written.
    """

    index: int
    time_ns: int
    fault: str = ""
    reason: str = ""
    picture: Picture | None = None
    frame: NDArray[np.float32] | None = None
    estimate: DepthEstimate | None = None
    sharp: NDArray | None = None
    seconds: dict[str, float] = dataclasses.field(default_factory=dict)
    messages: tuple[tuple[str, memoryview], ...] = ()


@dataclasses.dataclass(frozen=True, eq=False)
class _Batch:
    """Messages in the order of the bag, and the frame that the last of them is, if any."""

    copies: tuple[Recorded, ...]
    frame: FrameResult | None = None


class BagPipeline:
    """Reads a bag, works on the frames of one topic, and writes another bag.

    Parameters
    ----------
    image : Topic
        Of the frames.
    outputs : Outputs
    camera : Camera
    estimator : DepthEstimator
        For frames of the camera's size; in one thread, because it may remember frames.
    deblurrer : Deblurrer or None
        None: no all-in-focus frames are made. Must not remember frames.
    gamma : float or "srgb"
        Of 8-bit frames.
    map_size : (int, int) or None
        Rows and columns of the depth images; that of the frames by default.
    threads : int
        That deblur.

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
        estimator: DepthEstimator,
        deblurrer: Deblurrer | None,
        gamma: Gamma,
        map_size: tuple[int, int] | None,
        threads: int,
    ) -> None:
        self._image, self._outputs = image, outputs
        self._estimator, self._deblurrer = estimator, deblurrer
        self._size = camera.image_height, camera.image_width
        self._map_size = map_size or self._size
        self._gamma, self._threads = gamma, threads
        self._convert = Conversion()
        # The camera file's, until the bag has one.
        self._info = self._convert.info_of(camera.intrinsics)
        self._info_topic: str | None = None
        self.faults: Counter[str] = Counter()
        self.reasons: dict[str, str] = {}

    def topics(self) -> list[Topic]:
        """Return the topics of the results."""
        names = self._outputs
        kinds = {names.depth: IMAGE, names.confidence: IMAGE, names.depth_info: CAMERA_INFO}
        if self._deblurrer is not None:
            kinds |= {names.deblurred: IMAGE, names.deblurred_info: CAMERA_INFO}
        return [self._convert.topic(name, kind) for name, kind in kinds.items()]

    def prepare(self, frame: NDArray[np.float32]) -> None:
        """Do before the first frame what it would wait for."""
        try:
            estimate = self._estimator.estimate(frame, self._map_size)
            if self._deblurrer is not None:
                self._deblurrer.deblur(frame, estimate.blur_size_px, estimate.noise)
        except InputError:
            pass  # said when the frame's turn comes
        self._estimator.reset()

    def run(
        self, bag: Bag, writer: BagWriter, info_topic: str | None = None
    ) -> Iterator[tuple[tuple[Recorded, ...], FrameResult | None]]:
        """Copy all messages, and write the results of every frame right behind it.

        Parameters
        ----------
        bag : Bag
        writer : BagWriter
            With the topics of the bag and the results.
        info_topic : str, optional
            Of the camera models in the bag.

        Yields
        ------
        copies : tuple of Recorded
            Messages that were copied.
        result : FrameResult or None
            Of the frame that is the last of them.
        """
        self._info_topic = info_topic
        # Threads of their own work on frames side by side.
        with opencv_threads(1):
            decoded = in_order(self._decode, self._batches(bag), 1, _AHEAD)
            estimated = in_order(self._estimate, decoded, 1, _AHEAD)
            threads = self._threads
            for batch in in_order(self._deblur, estimated, threads, _AHEAD * threads):
                for message in batch.copies:
                    writer.write(message.topic, message.time_ns, message.data)
                result = batch.frame
                if result is not None:
                    for topic, data in result.messages:
                        writer.write(topic, result.time_ns, data)
                    if result.fault:
                        self.faults[result.fault] += 1
                        self.reasons.setdefault(result.fault, result.reason)
                yield batch.copies, result

    def _batches(self, bag: Bag) -> Iterator[_Batch]:
        copies: list[Recorded] = []
        waiting, index = 0, 0
        for message in bag.messages():
            copies.append(message)
            waiting += len(message.data)
            if message.topic == self._image.name:
                yield _Batch(tuple(copies), FrameResult(index, message.time_ns))
                index += 1
            elif waiting > _WAITING_BYTES:
                yield _Batch(tuple(copies))
            else:
                continue
            copies, waiting = [], 0
        yield _Batch(tuple(copies))

    def _decode(self, batch: _Batch) -> _Batch:
        for message in batch.copies:
            if message.topic == self._info_topic:
                self._take_info(message.data)
        if batch.frame is None:
            return batch
        start = time.perf_counter()
        try:
            picture = self._convert.picture(batch.copies[-1].data, self._image.type_name)
            frame = frame_from_pixels(picture.pixels, self._gamma)
            self._check_size(frame.shape)
        except InputError as error:
            return _failed(batch, error, "frame")
        return _with(
            batch,
            picture=picture,
            frame=frame,
            seconds={"decode": time.perf_counter() - start},
        )

    def _estimate(self, batch: _Batch) -> _Batch:
        result = batch.frame
        if result is None or result.frame is None:
            return batch
        start = time.perf_counter()
        try:
            estimate = self._estimator.estimate(result.frame, self._map_size)
        except InputError as error:
            return _failed(batch, error, "frame")
        seconds = {**result.seconds, "depth": time.perf_counter() - start}
        return _with(batch, estimate=estimate, seconds=seconds)

    def _deblur(self, batch: _Batch) -> _Batch:
        result = batch.frame
        if result is None or result.estimate is None or result.picture is None:
            return batch
        estimate, header, names = result.estimate, result.picture.header, self._outputs
        messages = [
            (names.depth, self._convert.image(_metres(estimate), "32FC1", header)),
            (names.confidence, self._convert.image(estimate.confidence, "32FC1", header)),
            (names.depth_info, self._resized_info(self._map_size, header)),
        ]
        start = time.perf_counter()
        sharp, fault, reason = None, "", ""
        if self._deblurrer is not None and result.frame is not None:
            try:
                sharp = self._sharp(self._deblurrer, result, estimate)
            except InputError as error:
                fault, reason = "no depth", str(error)
            else:
                image = self._convert.image(sharp, result.picture.encoding, header)
                messages.append((names.deblurred, image))
                messages.append((names.deblurred_info, self._resized_info(self._size, header)))
        seconds = {**result.seconds, "deblur": time.perf_counter() - start}
        return _with(
            batch,
            sharp=sharp,
            seconds=seconds,
            messages=tuple(messages),
            fault=fault,
            reason=reason,
        )

    def _sharp(self, deblurrer: Deblurrer, result: FrameResult, estimate: DepthEstimate) -> NDArray:
        assert result.frame is not None
        assert result.picture is not None
        sharp = deblurrer.deblur(result.frame, estimate.blur_size_px, estimate.noise)
        return pixels_from_frame(sharp, result.picture.encoding, self._gamma)

    def _resized_info(self, size: tuple[int, int], header: Any) -> memoryview:
        return self._convert.scaled_camera_info(self._info, size, header)

    def _take_info(self, data: bytes) -> None:
        """Take a camera model of the bag, unless it is empty or of another size."""
        try:
            info = self._convert.camera_info(data)
        except MessageError:
            return
        if (info.height, info.width) == self._size and info.k[0] > 0 and info.k[4] > 0:
            self._info = info

    def _check_size(self, shape: tuple[int, ...]) -> None:
        if shape[:2] != self._size:
            raise MessageError(
                "size",
                f"the frame is {shape[1]}x{shape[0]}, others are {self._size[1]}x{self._size[0]}",
            )


def _metres(estimate: DepthEstimate) -> NDArray[np.float32]:
    if estimate.depth_m is None:
        raise InputError("the bank and the camera file give no depth")
    return estimate.depth_m


def _with(batch: _Batch, **changes: Any) -> _Batch:
    assert batch.frame is not None
    return dataclasses.replace(batch, frame=dataclasses.replace(batch.frame, **changes))


def _failed(batch: _Batch, error: InputError, kind: str) -> _Batch:
    kind = error.kind if isinstance(error, MessageError) else kind
    return _with(batch, fault=kind, reason=str(error))
