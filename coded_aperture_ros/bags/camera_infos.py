"""The camera model that belongs to each frame of a bag."""

import dataclasses
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from operator import attrgetter
from typing import Any

from coded_aperture_ros.bags import codec
from coded_aperture_ros.bags.contents import BagMessage, Topic
from coded_aperture_ros.bags.pairing import DOUBTFUL_NS, TOLERANCE_NS
from coded_aperture_ros.bags.reading import Bag
from coded_aperture_ros.bags.topics import camera_info_topic
from coded_aperture_ros.io.messages import CameraInfos, MessageError, has_matrices

# Messages that wait for the camera model of a frame before them, at most.
_WAITING_FRAMES = 2
_WAITING_BYTES = 32 * 2**20
# Models of which the time of recording is known: more than come while frames wait.
_KEPT_INFOS = 100


def first_info(bag: Bag, image: Topic) -> Any:
    """First camera model of a topic of images that has a calibration.

    Without one, the first that says what frames show of the view; None if there is neither.
    """
    topic = camera_info_topic(bag.topics, image)
    infos = CameraInfos()
    for message in () if topic is None else bag.messages(topic):
        with suppress(MessageError):
            infos.receive(codec.read_camera_info(message.data))
        found = infos.at(0)
        if found is not None and has_matrices(found):
            break
    return infos.at(0)


def frames_with_infos(
    bag: Bag, image: Topic, first: Any, refuse: Callable[[str], None] = lambda reason: None
) -> Iterator[tuple[BagMessage, Any]]:
    """Yield the frames of a bag, each with its camera model; see `with_infos`."""
    info_topic = camera_info_topic(bag.topics, image)
    topics = (image.name,) if info_topic is None else (image.name, info_topic)
    for message, info in with_infos(bag.messages(*topics), image.name, info_topic, first, refuse):
        if message.topic == image.name:
            yield message, info


def with_infos(
    messages: Iterable[BagMessage],
    image_topic: str,
    info_topic: str | None,
    first: Any,
    refuse: Callable[[str], None] = lambda reason: None,
) -> Iterator[tuple[BagMessage, Any]]:
    """Yield messages in their order, each with the camera model that is valid with it.

    A frame's model is the one with its stamp, even if that was recorded after it, or else the
    newest before it. Where stamps are 0 or repeated, it is the one recorded nearest to it.

    Parameters
    ----------
    messages : iterable of BagMessage
    image_topic, info_topic : str
        Of the frames and, if there is one, of their camera models.
    first : message or None
        Model until one has come; see `first_info`.
    refuse : callable, optional
        Called with the reason why a model is not used.
    """
    infos = _RecordedInfos(refuse)
    waiting: deque[BagMessage] = deque()
    frames = size = 0

    def next_one() -> tuple[BagMessage, Any]:
        nonlocal frames, size
        message = waiting.popleft()
        size -= len(message.data)
        is_frame = message.topic == image_topic
        frames -= is_frame
        found = infos.of_frame(message) if is_frame else infos.newest
        return message, first if found is None else found

    for message in messages:
        waiting.append(message)
        size += len(message.data)
        frames += message.topic == image_topic
        if message.topic == info_topic:
            with suppress(MessageError):
                infos.receive(message)
        while waiting and (
            info_topic is None
            or waiting[0].topic != image_topic
            or infos.has_model_of(waiting[0])
            or frames > _WAITING_FRAMES
            or size > _WAITING_BYTES
        ):
            yield next_one()
    while waiting:
        yield next_one()


@dataclasses.dataclass(frozen=True)
class _Recorded:
    """Model that holds since a camera_info was recorded, and whether its stamp tells it apart."""

    time_ns: int
    stamp_ns: int
    told: bool
    model: Any


class _RecordedInfos:
    """Camera models with the times of their recording, for frames whose stamps do not tell."""

    def __init__(self, refuse: Callable[[str], None]) -> None:
        self._infos = CameraInfos(refuse)
        self._recorded: deque[_Recorded] = deque(maxlen=_KEPT_INFOS)
        self._info_stamp_ns = 0
        self._frame_stamp_ns = 0

    @property
    def newest(self) -> Any:
        """Model that has come last; None if none has."""
        return self._infos.at(0)

    def receive(self, message: BagMessage) -> None:
        """Keep the model of a message; a `MessageError` if it has none."""
        stamp_ns = message.stamp_ns
        told = stamp_ns not in (0, self._info_stamp_ns)
        self._info_stamp_ns = stamp_ns
        self._infos.receive(codec.read_camera_info(message.data))
        self._recorded.append(_Recorded(message.time_ns, stamp_ns, told, self.newest))

    def has_model_of(self, frame: BagMessage) -> bool:
        """Whether a model with the stamp of a frame was recorded beside it."""
        found = self._with_stamp(frame)
        return found is not None and abs(found.time_ns - frame.time_ns) <= TOLERANCE_NS

    def of_frame(self, frame: BagMessage) -> Any:
        """Model of the next frame; None if none was recorded before it, nor beside it."""
        told = frame.stamp_ns not in (0, self._frame_stamp_ns)
        self._frame_stamp_ns = frame.stamp_ns
        found = self._with_stamp(frame) if told else None
        if found is None:
            untold = (each for each in self._recorded if not (told and each.told))
            found = _nearest(untold, frame, TOLERANCE_NS)
        if found is None:
            before = (each for each in self._recorded if each.time_ns <= frame.time_ns)
            found = max(before, key=attrgetter("time_ns"), default=None)
        return None if found is None else found.model

    def _with_stamp(self, frame: BagMessage) -> _Recorded | None:
        """Model with the stamp of a frame; of several, the one recorded nearest to it."""
        same = (each for each in self._recorded if frame.stamp_ns == each.stamp_ns != 0)
        return _nearest(same, frame, DOUBTFUL_NS)


def _nearest(found: Iterable[_Recorded], frame: BagMessage, most_ns: int) -> _Recorded | None:
    """Model that was recorded nearest to a frame, and not farther from it than a time."""

    def apart_ns(each: _Recorded) -> int:
        return abs(each.time_ns - frame.time_ns)

    nearest = min(found, key=apart_ns, default=None)
    return nearest if nearest is not None and apart_ns(nearest) <= most_ns else None
