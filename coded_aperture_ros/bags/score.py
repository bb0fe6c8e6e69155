"""Errors of the depth of a bag against the depth that another camera recorded."""

import dataclasses
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.bags.codec import read_depth_image
from coded_aperture_ros.bags.contents import BagMessage
from coded_aperture_ros.bags.frames import DepthMaps, ProcessedFrame
from coded_aperture_ros.bags.pairing import Pair
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.depth import range_complaint
from coded_aperture_ros.io.messages import MessageError, depth_from_pixels
from coded_aperture_ros.metrics import Reliability
from coded_aperture_ros.metrics.errors import RelativeError

# Relative error that counts as right: the confidence is the probability of it.
RIGHT_WITHIN = 0.05
# Frames that wait for their reference, at most; twice as many references wait for frames.
_WAITING = 64


@dataclasses.dataclass(frozen=True, eq=False)
class FrameScore:
    """Errors of the depth of one frame.

    Attributes
    ----------
    error : RelativeError
        Of the pixels of the depth image whose reference is known.
    pair : Pair
        How the reference was found.
    reliability : Reliability
        Of the pixels that have both; right is within 5 %.
    reference_m : ndarray, float32 [rows, columns]
        Reference at the size of the depth image.
    complaint : str
        One line if the reference seems to be of another unit; see `range_complaint`.
    """

    error: RelativeError
    pair: Pair
    reliability: Reliability
    reference_m: FloatArray
    complaint: str = ""


def frame_score(
    depth_m: FloatArray,
    confidence: FloatArray,
    reference: NDArray,
    pair: Pair,
    range_m: tuple[float, float] | None = None,
) -> FrameScore:
    """Score of a depth image against a reference of any size that shows the same view.

    Every pixel of the depth image is compared with the nearest one of the reference.

    Parameters
    ----------
    depth_m, confidence : ndarray, float32 [rows, columns]
        Depth is not finite where unknown.
    reference : ndarray, float32 (m) or uint16 (mm) [other rows, other columns]
        See `messages.depth_from_pixels`.
    pair : Pair
        How the reference was found.
    range_m : (float, float), optional
        Nearest and farthest depth of the bank, m, with which the reference is compared.

    Raises
    ------
    MessageError
        If the reference has other proportions.
    """
    reference_m = depth_from_pixels(resize_reference(reference, depth_m.shape))
    known = np.isfinite(reference_m)
    # Numbers of pixels are a third faster to look up than a mask of them.
    both = np.flatnonzero(known & np.isfinite(depth_m))
    found, true, sure = (np.take(values, both) for values in (depth_m, reference_m, confidence))
    errors = np.abs((found - true) / true)
    reliability = Reliability.from_estimates(sure, errors <= RIGHT_WITHIN)
    error = RelativeError.from_errors(errors, int(np.count_nonzero(known)))
    complaint = "" if range_m is None else range_complaint(reference_m, range_m)
    return FrameScore(error, pair, reliability, reference_m, complaint)


def resize_reference(reference: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Reference at the size (rows, columns) of another depth image, by nearest pixels.

    A `MessageError` of kind "reference" if the proportions differ: it would be of another view.
    """
    height, width = reference.shape
    if abs(height * shape[1] - width * shape[0]) > max(height, width):
        raise MessageError(
            "reference",
            f"reference depth of {width}x{height} does not have the proportions of the depth "
            f"image, {shape[1]}x{shape[0]}",
        )
    size = shape[1], shape[0]
    return np.asarray(cv2.resize(reference, size, interpolation=cv2.INTER_NEAREST_EXACT))


def summary(scores: list[FrameScore]) -> dict[str, Any]:
    """Summary of the scores of frames, ready for JSON.

    Medians are medians over the frames of each frame's value; means and shares are over all
    pixels of all frames.
    """
    errors = [score.error for score in scores]
    pixels = np.array([error.pixels for error in errors], np.float64)
    covered = np.array([error.coverage for error in errors]) * pixels
    counted = covered > 0
    reliability = Reliability.total([score.reliability for score in scores])

    def over_pixels(name: str) -> float | None:
        values = np.array([getattr(error, name) for error in errors])
        if not counted.any():
            return None
        return float(np.sum(values[counted] * covered[counted]) / np.sum(covered))

    medians = [error.median for error in errors if np.isfinite(error.median)]
    calibration = reliability.expected_calibration_error
    return {
        "frames": len(scores),
        "median_relative_error": float(np.median(medians)) if medians else None,
        "mean_relative_error": over_pixels("mean"),
        "within_10_percent": over_pixels("within_10_percent"),
        "coverage": float(covered.sum() / pixels.sum()) if pixels.sum() else None,
        **_apart(score.pair for score in scores),
        "right_within": RIGHT_WITHIN,
        "complaint": _usual_complaint(scores),
        "expected_calibration_error": calibration if np.isfinite(calibration) else None,
        "reliability": reliability.rows(),
    }


def _usual_complaint(scores: list[FrameScore]) -> str:
    """First complaint, if most frames have one."""
    complaints = [score.complaint for score in scores if score.complaint]
    return complaints[0] if 2 * len(complaints) > len(scores) else ""


def _apart(pairs: Iterable[Pair]) -> dict[str, Any]:
    """How many pairs were found by each of the two times, and how far apart they are at most."""
    by_stamp: list[int] = []
    by_recording: list[int] = []
    for pair in pairs:
        (by_recording if pair.by_recording else by_stamp).append(pair.apart_ns)
    return {
        "paired_by_stamp": len(by_stamp),
        "most_stamps_apart_s": 1e-9 * max(by_stamp) if by_stamp else None,
        "paired_by_recording": len(by_recording),
        "most_recordings_apart_s": 1e-9 * max(by_recording) if by_recording else None,
    }


class References:
    """Pairs of depth images and references of the same time, whichever comes first.

    Parameters
    ----------
    topic : str
    pairs : dict of int to Pair
        References of the frames, see `pairing.pair_messages`.

    Attributes
    ----------
    range_m : (float, float) or None
        Nearest and farthest depth of the bank, m.
    """

    def __init__(self, topic: str, pairs: Mapping[int, Pair]) -> None:
        self.topic = topic
        self.range_m: tuple[float, float] | None = None
        self._pairs = dict(pairs)
        self._left = Counter(pair.reference for pair in self._pairs.values())
        self._references: dict[int, NDArray] = {}
        self._frames: dict[int, DepthMaps] = {}
        self._count = 0

    def add_messages(self, messages: Iterable[BagMessage]) -> None:
        """Take the references among messages; a `MessageError` if one is no depth image."""
        for message in messages:
            if message.topic == self.topic:
                if self._left[self._count]:
                    self._references[self._count] = read_depth_image(message.data).pixels
                self._count += 1
        while len(self._references) > 2 * _WAITING:
            del self._references[min(self._references)]

    def add_frame(self, index: int, result: ProcessedFrame) -> None:
        """Take the depth of a frame, if it has any."""
        if index not in self._pairs:
            return
        if result.maps is None:
            self._release(index)
            return
        self._frames[index] = result.maps
        while len(self._frames) > _WAITING:
            late = next(iter(self._frames))
            del self._frames[late]
            self._release(late)

    def scores(self) -> Iterator[tuple[int, FrameScore]]:
        """Yield indices and scores of frames whose references have come."""
        for index, maps in list(self._frames.items()):
            pair = self._pairs[index]
            if (reference := self._references.get(pair.reference)) is None:
                continue
            del self._frames[index]
            self._release(index)
            yield index, frame_score(maps.depth_m, maps.confidence, reference, pair, self.range_m)

    def _release(self, index: int) -> None:
        """Forget the reference of a frame, if no other frame has it."""
        reference = self._pairs[index].reference
        self._left[reference] -= 1
        if not self._left[reference]:
            self._references.pop(reference, None)
