"""The camera model that belongs to each frame of a bag."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any

from coded_aperture_ros.bags import codec
from coded_aperture_ros.bags.contents import BagMessage
from coded_aperture_ros.bags.reading import Bag
from coded_aperture_ros.io.messages import CameraInfos, MessageError, has_matrices

# Messages that wait for the camera model of a frame before them, at most.
_WAITING_FRAMES = 2
_WAITING_BYTES = 32 * 2**20


def first_info(bag: Bag, topic: str | None) -> Any:
    """First camera model of a topic that has a calibration.

    Without one, the first that says what frames show of the view; None if there is neither.
    """
    infos = CameraInfos()
    for message in () if topic is None else bag.messages(topic):
        with suppress(MessageError):
            infos.receive(codec.read_camera_info(message.data))
        found = infos.at(0)
        if found is not None and has_matrices(found):
            break
    return infos.at(0)


def with_infos(
    messages: Iterable[BagMessage],
    image_topic: str,
    info_topic: str | None,
    first: Any,
    refuse: Callable[[str], None] = lambda reason: None,
) -> Iterator[tuple[BagMessage, Any]]:
    """Yield messages in their order, each with the camera model that is valid with it.

    A frame's model is the one with its stamp, even if that was recorded after it, or else the
    newest before it.

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
    infos = CameraInfos(refuse)
    waiting: deque[BagMessage] = deque()
    frames = size = 0

    def next_one() -> tuple[BagMessage, Any]:
        nonlocal frames, size
        message = waiting.popleft()
        size -= len(message.data)
        is_frame = message.topic == image_topic
        frames -= is_frame
        found = infos.at(message.stamp_ns if is_frame else 0)
        return message, first if found is None else found

    for message in messages:
        waiting.append(message)
        size += len(message.data)
        frames += message.topic == image_topic
        if message.topic == info_topic:
            with suppress(MessageError):
                infos.receive(codec.read_camera_info(message.data))
        while waiting and (
            info_topic is None
            or waiting[0].topic != image_topic
            or infos.has(waiting[0].stamp_ns)
            or frames > _WAITING_FRAMES
            or size > _WAITING_BYTES
        ):
            yield next_one()
    while waiting:
        yield next_one()
