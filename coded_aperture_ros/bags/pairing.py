"""Which reference belongs to which frame: by stamps where they tell frames apart.

Drivers that set no stamps, repeat them, or take them from another clock are common. Their messages
are paired by the time of recording; that is a worse clock, because messages arrive late.
"""

import dataclasses
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bags.contents import BagMessage
from coded_aperture_ros.core.arrays import BoolArray

# A reference this far from a frame, ns, is of the same time.
TOLERANCE_NS = 20_000_000
# Pairs recorded farther apart, ns, may be of two clocks whose stamps overlap by chance.
DOUBTFUL_NS = 1_000_000_000


@dataclasses.dataclass(frozen=True, eq=False)
class MessageTimes:
    """Times of the messages of a topic, in their order.

    Attributes
    ----------
    stamps_ns, recorded_ns : ndarray, int64 [n]
    """

    stamps_ns: NDArray[np.int64]
    recorded_ns: NDArray[np.int64]

    @classmethod
    def of_images(cls, messages: Iterable[BagMessage]) -> "MessageTimes":
        """Times of image messages; a stamp is 0 where there is none."""
        times = [(message.stamp_ns, message.time_ns) for message in messages]
        stamps, recorded = np.array(times, np.int64).reshape(-1, 2).T
        return cls(stamps, recorded)


@dataclasses.dataclass(frozen=True)
class Pair:
    """Reference of a frame.

    Attributes
    ----------
    reference : int
        Its index in its topic.
    apart_ns : int
        Between the stamps, or the times of recording.
    by_recording : bool
        Whether it was found by the time of recording.
    """

    reference: int
    apart_ns: int
    by_recording: bool = False


def pair_messages(frames: MessageTimes, references: MessageTimes) -> dict[int, Pair]:
    """Pair each frame with the reference of its time, by the indices of the frames.

    A stamp counts if it is not 0 and no other message of its topic has it. If the pairs by stamps
    contradict the order of the recording, or are rare and were recorded far apart, stamps are of
    two clocks. Frames whose stamps do not count are paired by the time of recording, and so are all
    if no stamps do. A frame without a reference of its time has no pair.
    """
    frame_stamped = _once(frames.stamps_ns) & (frames.stamps_ns > 0)
    reference_stamped = _once(references.stamps_ns) & (references.stamps_ns > 0)
    by_stamp = _nearest(frames.stamps_ns, references.stamps_ns, frame_stamped, reference_stamped)
    frame_told = _once(frames.recorded_ns)
    reference_told = _once(references.recorded_ns)

    def by_recording(frame_counts: BoolArray, reference_counts: BoolArray) -> dict[int, Pair]:
        times = frames.recorded_ns, references.recorded_ns
        found = _nearest(*times, frame_told & frame_counts, reference_told & reference_counts)
        return {
            index: dataclasses.replace(pair, by_recording=True) for index, pair in found.items()
        }

    if not by_stamp or _contradicts(by_stamp, frames, references):
        every = by_recording(np.ones_like(frame_told), np.ones_like(reference_told))
        if not by_stamp or len(every) >= len(by_stamp):
            return every
    free = np.ones_like(reference_told)
    free[[pair.reference for pair in by_stamp.values()]] = False
    unstamped = by_recording(~frame_stamped, free)
    # A frame with a stamp may belong to a reference without one.
    stamped = by_recording(frame_stamped, ~reference_stamped)
    return {**unstamped, **stamped, **by_stamp}


def _once(times_ns: NDArray[np.int64]) -> BoolArray:
    """Which times are those of one message alone."""
    _, inverse, counts = np.unique(times_ns, return_inverse=True, return_counts=True)
    return np.asarray(counts[inverse.reshape(-1)] == 1)


def _nearest(
    frames_ns: NDArray[np.int64],
    references_ns: NDArray[np.int64],
    frame_counts: BoolArray,
    reference_counts: BoolArray,
) -> dict[int, Pair]:
    """Pair frames with the nearest reference within the tolerance, of those that count."""
    order = np.flatnonzero(reference_counts)
    if not len(order):
        return {}
    order = order[np.argsort(references_ns[order], kind="stable")]
    sorted_ns = references_ns[order]
    pairs = {}
    for index in np.flatnonzero(frame_counts):
        place = int(np.searchsorted(sorted_ns, frames_ns[index]))
        around = [at for at in (place - 1, place) if 0 <= at < len(order)]
        best = min(around, key=lambda at: abs(int(sorted_ns[at]) - int(frames_ns[index])))
        apart_ns = abs(int(sorted_ns[best]) - int(frames_ns[index]))
        if apart_ns <= TOLERANCE_NS:
            pairs[int(index)] = Pair(int(order[best]), apart_ns)
    return pairs


def _contradicts(pairs: dict[int, Pair], frames: MessageTimes, references: MessageTimes) -> bool:
    """Whether pairs by stamps are not those of the recording."""
    recorded_ns = frames.recorded_ns[list(pairs)]
    partners_ns = references.recorded_ns[[pair.reference for pair in pairs.values()]]
    steps = np.sign(np.diff(recorded_ns)) * np.sign(np.diff(partners_ns))
    if np.sum(steps < 0) > np.sum(steps > 0):
        return True
    return bool(abs(np.median(partners_ns - recorded_ns)) > DOUBTFUL_NS)
