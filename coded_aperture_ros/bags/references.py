"""The depth that another camera recorded, found for the frames of the same time."""

from collections.abc import Iterable, Iterator

from numpy.typing import NDArray

from coded_aperture_ros.bags.frames import DepthMaps, ProcessedFrame
from coded_aperture_ros.bags.score import FrameScore, frame_score
from coded_aperture_ros.io.bags.codec import read_depth_image, stamp_ns_of
from coded_aperture_ros.io.bags.recorded import Recorded

# A reference counts as of the same time up to this far from a frame.
TOLERANCE_NS = 20_000_000
# Frames that wait for their reference at most, and the other way round.
_WAITING = 64


class References:
    """Pairs depth images with the references of the same time, whichever comes first."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self._references: dict[int, NDArray] = {}
        self._frames: dict[int, tuple[int, DepthMaps]] = {}

    def add_messages(self, messages: Iterable[Recorded]) -> None:
        """Take the references among some messages; a `MessageError` if one is no depth image."""
        for message in messages:
            if message.topic == self.topic:
                picture = read_depth_image(message.data)
                self._references[picture.stamp_ns] = picture.pixels
        while len(self._references) > 2 * _WAITING:
            del self._references[min(self._references)]

    def add_frame(self, index: int, result: ProcessedFrame) -> None:
        """Take the depth of a frame, if it has any."""
        if result.maps is not None:
            self._frames[index] = stamp_ns_of(result.header), result.maps

    def scores(self, end: bool = False) -> Iterator[tuple[int, FrameScore]]:
        """Yield what can be scored by now, with the frames' indices; in the end what is left."""
        for index, (stamp_ns, maps) in list(self._frames.items()):
            nearest = min(self._references, key=lambda at: abs(at - stamp_ns), default=None)
            apart_ns = TOLERANCE_NS + 1 if nearest is None else abs(nearest - stamp_ns)
            late = end or len(self._frames) > _WAITING
            if apart_ns and not late:
                continue
            del self._frames[index]
            if nearest is not None and apart_ns <= TOLERANCE_NS:
                reference = self._references[nearest]
                yield index, frame_score(maps.depth_m, maps.confidence, reference, apart_ns)
