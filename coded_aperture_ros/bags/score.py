"""Depth of a bag against the depth that another camera recorded beside it."""

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.io.messages import MessageError, depth_from_pixels
from coded_aperture_ros.metrics import Reliability
from coded_aperture_ros.metrics.errors import RelativeError

# What the confidence promises.
RIGHT_WITHIN = 0.05


@dataclasses.dataclass(frozen=True, eq=False)
class FrameScore:
    """How good the depth of one frame is."""

    error: RelativeError  # of the pixels of the depth image whose reference is known
    apart_ns: int  # between the stamps of depth and reference
    reliability: Reliability  # of the pixels that have both; right is within 5 %
    reference_m: NDArray[np.float32]  # as it was compared, [rows, columns]


def frame_score(
    depth_m: NDArray[np.float32],
    confidence: NDArray[np.float32],
    reference: NDArray,
    apart_ns: int = 0,
) -> FrameScore:
    """Compare a depth image with a reference of any size that shows the same view.

    Every pixel of the depth image, not finite where unknown, is compared with the nearest one of
    the reference, which is float32 (m) or uint16 (mm), see `messages.depth_from_pixels`.
    """
    reference_m = depth_from_pixels(at_size(reference, depth_m.shape))
    known = np.isfinite(reference_m)
    # Numbers of pixels are a third faster to look up than a mask of them.
    both = np.flatnonzero(known & np.isfinite(depth_m))
    found, true, sure = (np.take(values, both) for values in (depth_m, reference_m, confidence))
    errors = np.abs((found - true) / true)
    reliability = Reliability.of(sure, errors <= RIGHT_WITHIN)
    error = RelativeError.of_known(errors, int(np.count_nonzero(known)))
    return FrameScore(error, apart_ns, reliability, reference_m)


def at_size(reference: NDArray, shape: tuple[int, ...]) -> NDArray:
    """Return a reference at the size (rows, columns) of another depth image, by nearest pixels.

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
    """Sum up the scores of frames, ready for JSON.

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
        "most_stamps_apart_s": 1e-9 * max(score.apart_ns for score in scores),
        "right_within": RIGHT_WITHIN,
        "expected_calibration_error": calibration if np.isfinite(calibration) else None,
        "reliability": reliability.rows(),
    }
