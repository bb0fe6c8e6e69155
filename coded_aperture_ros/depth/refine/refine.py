"""Decides levels by a small network that has learned what edges do to cost volumes."""

import cv2
import numpy as np

from coded_aperture_ros.bank import FilterBank
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.core.stages import Stages
from coded_aperture_ros.depth.config import DepthConfig
from coded_aperture_ros.depth.decision import Decision
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.refine.cells import Cells
from coded_aperture_ros.depth.refine.features import (
    BLUR_SIZES_PX,
    LARGEST_PX,
    cost_features,
    frame_features,
    tried_sizes,
)
from coded_aperture_ros.depth.refine.network import Network
from coded_aperture_ros.depth.refine.probabilities import HalfCells, chosen_neighbours, drawn
from coded_aperture_ros.depth.regularize import LEARNED
from coded_aperture_ros.depth.upsample import MapGrid
from coded_aperture_ros.likelihood import Cost, LikelihoodModel

# What the network was trained for.
_WINDOWS_PX = (24, 72)
_STRIDES_PX = (4, 12)
# Neighbouring half-cells whose blur sizes differ by at most this are one surface.
_ONE_SURFACE_PX = 0.8
_PLAUSIBLE = 0.05
# Costs that differ by less are those of a frame without any texture.
_ALIKE = 1e-3
# Logistic calibration of how likely a depth is right, fitted on random scenes kept apart.
_CALIBRATION = (-0.06, 1.03)
_DEVIATION = 0.88
_SURE = 1e-3


def untrained(model: LikelihoodModel, stride_px: int) -> str:
    """Return why a model is not one that the network was trained for; empty if it is."""
    stack = model.stack
    if not isinstance(model, FilterBank):
        return "it is not a filter bank"
    if stack.has_both_sides:
        return "it has levels on both sides of the focal plane"
    if not stack.in_pixels:
        return "the blur sizes of its PSFs are not known in pixels"
    largest = float(np.abs(stack.blur_sizes_px).max())
    if largest > LARGEST_PX:
        return f"its blur of {largest:.3g} px is above {LARGEST_PX:g} px"
    for name, value, (low, high) in (
        ("window", model.window_px, _WINDOWS_PX),
        ("stride", stride_px, _STRIDES_PX),
    ):
        if not low <= value <= high:
            return f"its {name} of {value} px is not within {low} to {high} px"
    return ""


def refinement_note(model: LikelihoodModel, config: DepthConfig) -> str | None:
    """Return one line if the configuration asks for the network and another stands in for it."""
    if config.regularize != LEARNED:
        return None
    why = untrained(model, config.stride_px or model.stride_px)
    if not why:
        return None
    return (
        f"regularize: semiglobal in place of learned, which was not trained for this model: {why}"
    )


class Refined:
    """Decides the levels of frames of one size; see `Decide`."""

    def __init__(self, model: LikelihoodModel, levels: Levels) -> None:
        self._sizes = model.stack.blur_sizes_px
        self._levels = levels
        tried = tried_sizes(self._sizes)
        self._tried_px = BLUR_SIZES_PX[tried].astype(np.float32)
        self._network = Network(tried)
        self._tolerance = _tolerance_px(levels)
        # In front of the focal plane the nearer surface is the more blurred one.
        self._nearer_share = 1 - _PLAUSIBLE if self._sizes.mean() < 0 else _PLAUSIBLE

    def __call__(
        self,
        seen: Observation,
        volume: FloatArray,
        own: Cost,
        size: tuple[int, int],
        stages: Stages,
    ) -> Decision:
        """See `Decide`."""
        noise, grey = seen.noise.typical, seen.grey
        cells = Cells.covering(grey.shape, seen.grid)
        misfit = np.zeros(volume.shape[:2], np.float32) if own.misfit is None else own.misfit
        costs = cost_features(volume, misfit, seen.brightness, grey, noise, cells, self._sizes)
        logits = self._network(costs, frame_features(grey, noise, cells))
        found = HalfCells.of(logits, self._tried_px)
        right = _calibrated(found.right_within(self._tolerance_at(found.size_px)))
        deviation_px = found.deviation_px()
        quarters = chosen_neighbours(logits.choice)
        stages.lap("refine")

        def map_of(values: FloatArray, one_surface: float) -> FloatArray:
            whole = drawn(values, quarters, one_surface)[-cells.top :, -cells.left :]
            rows, columns = grey.shape
            whole = whole[:rows, :columns]
            if whole.shape != size:
                whole = cv2.resize(whole, size[::-1], interpolation=cv2.INTER_NEAREST)
            return np.ascontiguousarray(whole)

        level = self._level(map_of(found.size_px, _ONE_SURFACE_PX))
        confidence = map_of(right, 0.1)
        per_px = np.float32(abs((len(self._sizes) - 1) / np.ptp(self._sizes)))
        deviation = map_of(deviation_px * (per_px * np.float32(_DEVIATION)), 0.5)
        if volume.max() <= _ALIKE:  # nothing to go by anywhere
            confidence[:] = 0
        if not seen.usable.all():
            at = MapGrid.of(seen.grid, grey.shape, size)
            confidence[at.nearest(~seen.usable)] = 0

        def nearest_plausible() -> FloatArray:
            return self._level(map_of(found.quantile_px(self._nearer_share), _ONE_SURFACE_PX))

        return Decision(level, deviation, confidence, None, nearest_plausible)

    def _level(self, size_px: FloatArray) -> FloatArray:
        """Return the fractional level of blur sizes without their sign."""
        first, last = np.abs(self._sizes[[0, -1]])
        scale = np.float32((len(self._sizes) - 1) / (last - first))
        return np.clip((size_px - np.float32(first)) * scale, 0, len(self._sizes) - 1)

    def _tolerance_at(self, size_px: FloatArray) -> FloatArray:
        index = np.rint(self._level(size_px)).astype(np.intp)
        return self._tolerance[index]


def _tolerance_px(levels: Levels) -> FloatArray:
    """Return by how much the blur size of each level may be wrong for 5 % of its depth [L]."""
    sizes = levels.blur_sizes_px
    if levels.depths_m is None:
        return np.full(len(sizes), abs(np.mean(np.diff(sizes))), np.float32)
    inverse = 1 / levels.depths_m
    per_px = np.abs(np.gradient(inverse, sizes))
    return np.asarray(0.05 * np.abs(inverse) / per_px, np.float32)


def _calibrated(probability: FloatArray) -> FloatArray:
    offset, slope = map(np.float32, _CALIBRATION)
    odds_against = 1 / np.clip(probability, _SURE, 1 - _SURE) - 1
    return np.asarray(1 / (1 + np.exp(slope * np.log(odds_against) - offset)), np.float32)
