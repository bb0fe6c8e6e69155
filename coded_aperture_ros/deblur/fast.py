"""Methods `fast` and `inverse`: closed forms, which the other methods begin with."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.blend import Blend
from coded_aperture_ros.deblur.config import DeblurConfig
from coded_aperture_ros.deblur.inverse_filters import (
    COLOUR_NOISE,
    HalfBandFilters,
    InverseFilters,
    OpponentFilters,
)
from coded_aperture_ros.deblur.problem import Problem, VideoState, from_opponents
from coded_aperture_ros.optics import PsfStack

# Share of the pixels in a video that may have more noise than is assumed.
_FEW_FRAMES_QUANTILE = 0.1


class ClosedForm(OpponentFilters[InverseFilters]):
    """Inverse filters of a camera, for brightness and for colour differences."""

    def __init__(self, stack: PsfStack, rank: int, band: str, workers: Workers) -> None:
        filters = HalfBandFilters if band == "half" else InverseFilters
        super().__init__(filters, stack, rank, workers)
        self.reduction = filters.reduction

    def restore(
        self, channels: list[FloatArray], blur_size_px: FloatArray, noise: float
    ) -> list[FloatArray]:
        """Deblurred `opponents` of a frame; the map is smaller by `reduction`."""
        table_indices = self._brightness.table_indices(blur_size_px)
        restored = self._brightness.apply(channels[:1], table_indices, noise)
        if len(channels) > 1:
            restored += self._colour.apply(channels[1:], table_indices, COLOUR_NOISE * noise)
        return restored


class Inverse:
    """Each pixel filtered by the inverse of its own level's PSF; see `Method`."""

    # It cannot leave out pixels whose depth is wrong: it keeps away from edges.
    edge_reach_px = 14
    removes_motion = False

    def __init__(self, config: DeblurConfig, closed_form: ClosedForm) -> None:
        self._config = config
        self._closed_form = closed_form
        self.reduction = closed_form.reduction

    def restore(self, problem: Problem, _: VideoState) -> FloatArray:
        """All-in-focus frame; see `Method`."""
        noise = _visible_noise(problem) * float(np.sqrt(self._config.smoothness))
        channels = self._closed_form.restore(problem.channels, problem.blur_size_px, noise)
        sharp = from_opponents(channels)
        if self._config.band == "half":
            return sharp  # smoothing would gain 0.04 dB
        # Takes out what is left of noise and ringing between edges, up to 0.2 dB on ray-traced
        # scenes; differences of 0.04 count as edges. A wider filter gains 0.07 dB more at most,
        # and takes three times as long.
        return np.asarray(cv2.bilateralFilter(sharp, 3, 0.04, 2.0), np.float32)


class Fast:
    """Closed forms of several blur sizes, blended by a small network; see `Method`."""

    reduction = 1
    edge_reach_px = 0
    removes_motion = False

    def __init__(self, config: DeblurConfig, blend: Blend) -> None:
        self._config = config
        self._blend = blend

    def restore(self, problem: Problem, _: VideoState) -> FloatArray:
        """All-in-focus frame; see `Method`."""
        return from_opponents(
            self._blend.restore(
                problem.channels,
                problem.blur_size_px,
                problem.known,
                _visible_noise(problem),
                self._config.smoothness,
            )
        )


def _visible_noise(problem: Problem) -> float:
    """Noise for the whole frame: that of pixels with few frames, where it would be seen."""
    few = (
        float(np.quantile(problem.frame_count, _FEW_FRAMES_QUANTILE))
        if problem.frame_count.size > 1
        else 1.0
    )
    return problem.noise / float(np.sqrt(few))
