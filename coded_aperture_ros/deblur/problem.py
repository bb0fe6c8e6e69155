"""Input of a deblurring method: one frame, the video before it; and the method's interface."""

import dataclasses
from typing import Protocol

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.frames import StaticAverage, fill_unusable

# One bad pixel below this would spoil the whole frame through its Fourier transform.
_MIN_LIGHT = -1.0
# Light that came through the mask spreads: what is narrower is a fault of the sensor, or a light so
# small that nothing around it shows it.
_NARROW_PX = 3
# Orthonormal: noise that is alike and independent in red, green and blue stays so.
_OPPONENTS = np.float32(np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]]))
# A place that is the mean of more frames than this has not changed.
_STATIC_FRAMES = 1.5


def measured_pixels(
    frame: FloatArray, saturation: float
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Frame with filled gaps, and masks of measured and of saturated pixels [rows, columns].

    Pixels that are not finite, far from [0, 1], or as bright as `saturation` are not measured. A
    measured pixel is so in all channels. A saturated one is in some channels at least as bright as
    it is filled, and measured in the others.
    """
    # A NaN makes both comparisons false.
    measured = (frame > _MIN_LIGHT) & (frame < saturation)
    if measured.all():
        whole = np.ones(frame.shape[:2], bool)
        return np.ascontiguousarray(frame, np.float32), whole, ~whole
    at_least = _wide_parts((frame >= saturation) & np.isfinite(frame))
    recorded = frame[at_least]
    channels = zip(np.atleast_3d(frame).T, np.atleast_3d(measured).T, strict=True)
    frame = np.stack(
        [fill_unusable(np.ascontiguousarray(channel), mask) for channel, mask in channels]
    ).T.reshape(frame.shape)
    frame[at_least] = np.maximum(frame[at_least], recorded)
    known = measured | at_least
    if measured.ndim == 3:
        # Much faster than a reduction along so short an axis.
        measured, known = (each[..., 0] & each[..., 1] & each[..., 2] for each in (measured, known))
    return np.ascontiguousarray(frame, np.float32), measured, known & ~measured


def _wide_parts(mask: BoolArray) -> BoolArray:
    """Parts of a mask [rows, columns] or [rows, columns, 3] that are not narrow."""
    square = np.ones((_NARROW_PX, _NARROW_PX), np.uint8)
    core = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, square)
    return mask & (cv2.dilate(core, square) > 0)


def full_resolution_motion(
    motion_px: FloatArray | None, shape: tuple[int, ...]
) -> FloatArray | None:
    """Motion map [rows, columns, 2] in the size of the frame; None if nothing moves.

    Raises `InputError` if it is not [rows, columns, 2], or not of a floating type.
    """
    if motion_px is None:
        return None
    if motion_px.ndim != 3 or motion_px.shape[2] != 2 or not motion_px.size:
        raise InputError(f"motion: expected [rows, columns, 2], got {list(motion_px.shape)}")
    if not np.issubdtype(motion_px.dtype, np.floating):
        raise InputError(f"motion: expected floating values in px, got {motion_px.dtype}")
    if not np.nan_to_num(motion_px).any():
        return None
    motion = np.ascontiguousarray(motion_px, np.float32)
    size = (shape[1], shape[0])
    return np.asarray(cv2.resize(motion, size, interpolation=cv2.INTER_NEAREST_EXACT))


def opponents(image: FloatArray) -> list[FloatArray]:
    """Brightness and two colour differences of an image; a grey image alone.

    They are ``(r + g + b) / sqrt(3)``, ``(r - b) / sqrt(2)``, ``(r - 2 g + b) / sqrt(6)``.
    """
    if image.ndim == 2:
        return [image]
    return list(cv2.split(cv2.transform(image, _OPPONENTS)))


def from_opponents(channels: list[FloatArray]) -> FloatArray:
    """Image of its `opponents`."""
    if len(channels) == 1:
        return channels[0]
    return np.asarray(cv2.transform(cv2.merge(channels), _OPPONENTS.T), np.float32)


class VideoState:
    """Average of the coded frames of a video, along non-local weights in time, before deblurring.

    The thesis proposes such weights for depth (eq. 8.11) and leaves all-in-focus frames for later.
    Averaged coded frames have less noise, so that the filters may be sharper; averaged
    all-in-focus frames would only be less noisy. What moves by a fraction of a pixel restarts, and
    is deblurred as a single frame. With `most_frames` 0 nothing is remembered.
    """

    def __init__(self, most_frames: float) -> None:
        self._most_frames = most_frames
        self._averages: list[StaticAverage] = []
        self._shape: tuple[int, ...] = ()
        self._restored: list[FloatArray] | None = None

    def reset(self) -> None:
        """Forget the frames so far."""
        self._averages = []
        self._restored = None

    def add(self, channels: list[FloatArray], noise: float) -> tuple[list[FloatArray], FloatArray]:
        """Mean with one more frame, and the number of frames in it.

        Another number or size of channels than before begins another video. `noise` is the standard
        deviation of one frame's. The number is that of the channel that changed most, at least 1,
        float32 [rows, columns], or [1, 1] of single frames.
        """
        if not self._most_frames:
            return channels, np.ones((1, 1), np.float32)
        shape = (len(channels), *channels[0].shape)
        if shape != self._shape:
            self.reset()
            self._shape = shape
        if not self._averages:
            self._averages = [StaticAverage(self._most_frames) for _ in channels]
        pairs = zip(self._averages, channels, strict=True)
        means = [average.add(channel, noise) for average, channel in pairs]
        least = np.min([count for _, count in means], axis=0)
        frame_count = cv2.resize(least, shape[:0:-1], interpolation=cv2.INTER_LINEAR)
        return [mean.copy() for mean, _ in means], np.asarray(frame_count, np.float32)

    def start(self, closed_form: list[FloatArray], frame_count: FloatArray) -> list[FloatArray]:
        """Start of an iteration: the last result wherever nothing has changed."""
        if self._restored is None:
            return closed_form
        pairs = zip(self._restored, closed_form, strict=True)
        return [np.where(frame_count > _STATIC_FRAMES, last, fresh) for last, fresh in pairs]

    def keep(self, restored: list[FloatArray]) -> None:
        """Store a result, to begin with it next time."""
        if self._most_frames:
            self._restored = restored


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """One frame to be deblurred."""

    channels: list[FloatArray]  # [rows, columns], see `opponents`; averaged in a video
    frame_count: FloatArray  # that they are the mean of [rows, columns] or [1, 1]
    measured: BoolArray  # neither saturated nor impossible [rows, columns]
    clipped: BoolArray  # not measured, but at least as bright [rows, columns]
    blur_size_px: FloatArray  # signed, finite; as much smaller as the method asks for
    known: BoolArray  # where a blur size was given [rows, columns]
    motion_px: FloatArray | None  # [rows, columns, 2]; None if nothing moves
    noise: float  # standard deviation of one channel of one frame
    progress: Progress = iter


class Method(Protocol):
    """Deblurring method.

    Its blur maps are `reduction` times smaller than the frame; `edge_reach_px` is its distance from
    depth edges, which may be off.
    """

    reduction: int
    edge_reach_px: int
    removes_motion: bool

    def restore(self, problem: Problem, video: VideoState) -> FloatArray:
        """All-in-focus frame [rows, columns] or [rows, columns, 3], not yet clipped.

        An iterative method begins with what `video` has, and leaves its result there.
        """
