"""From the cost volume to the level of every pixel, and how sure it is, by classical means."""

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, Shape
from coded_aperture_ros.core.stages import Stages
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.edges import EdgeCorrection
from coded_aperture_ros.depth.decoders.posterior import (
    confidence_of,
    is_uninformative,
    level_deviation,
    level_probability,
    nearest_plausible_level,
)
from coded_aperture_ros.depth.decoders.regularize import Regularizer
from coded_aperture_ros.depth.decoders.sides import FocalSides
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.upsample import MapGrid
from coded_aperture_ros.likelihood import Cost


@dataclasses.dataclass(frozen=True, eq=False)
class Decision:
    """What was decided of every pixel of a map; all maps are float32 of one shape."""

    level: FloatArray  # fractional index into the model's levels
    deviation: FloatArray  # its standard deviation, in levels
    confidence: FloatArray  # probability, in [0, 1], that the level is right; see `DepthEstimate`
    side_confidence: FloatArray | None  # see `DepthEstimate`
    # Returns the level that the true one is hardly nearer than.
    nearest_plausible: Callable[[], FloatArray]
    # Returns the level that every pixel is nearer than at a risk, where that can be told.
    free_level: Callable[[float], FloatArray] | None = None
    # Returns level and share of a second surface in the window, NaN without one.
    second: Callable[[], tuple[FloatArray, FloatArray]] | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Regularized:
    """Decides by a regulariser, corrects foreground fattening, and lets each patch say how sure.

    `neighbours_decide` says whether a patch that is uninformative by itself has the level of its
    neighbours, and is not left open.
    """

    levels: Levels
    regularize: Regularizer
    correct_edges: EdgeCorrection
    sides: FocalSides | None
    neighbours_decide: bool
    workers: Workers

    def __call__(
        self, seen: Observation, volume: FloatArray, own: Cost, size: Shape, stages: Stages
    ) -> Decision:
        """Return the maps, at most of `size` (rows, columns).

        `volume` is the cost of every level by all frames, float32 [rows, columns, L], and `own`
        that of this frame alone, or of a mean of frames. `stages` takes down how long the parts
        took.
        """
        of_patches = self.regularize(volume, own.volume, seen.brightness, seen.grid.stride_px)
        stages.lap("regularise")
        at = MapGrid.worthwhile(seen.grid, seen.grey.shape, size)
        level = self.correct_edges(at.interpolated(of_patches), at.scale)
        probability = level_probability(volume)
        (confidence, of_side), deviation = self.workers.both(
            partial(self._confidence, level, of_patches, volume, probability, at),
            partial(self._deviation, level, volume, at),
        )
        uninformative = ~seen.usable | self._left_open(probability)
        if uninformative.any():
            confidence[at.nearest(uninformative)] = 0

        def nearest_plausible() -> FloatArray:
            nearest = nearest_plausible_level(probability, self.levels.nearest_first)
            return np.asarray(at.nearest(nearest.astype(np.float32)))

        return Decision(level, deviation, confidence, of_side, nearest_plausible)

    def _confidence(
        self,
        level: FloatArray,
        of_patches: FloatArray,
        volume: FloatArray,
        probability: FloatArray,
        at: MapGrid,
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return how likely each pixel's level is right, and how likely its side is."""
        agreement = self.levels.agreement
        if self.sides is None:
            return confidence_of(level, probability, at.patches, agreement), None
        of_side = at.nearest(self.sides.confidence(of_patches, volume, at.grid))
        given_side = self.sides.given(probability)
        confidence = confidence_of(level, given_side, at.patches, agreement)
        # Where both sides' depths are about the same, either is right.
        confidence *= np.where(self.sides.agree(level), 1, of_side)
        return confidence, of_side

    def _deviation(self, level: FloatArray, volume: FloatArray, at: MapGrid) -> FloatArray:
        """Return the standard deviation of each pixel's level, if its side is the right one."""
        if self.sides is None:
            return level_deviation(level, volume, at.patches)
        return self.sides.deviation(level, volume, at.patches)

    def _left_open(self, probability: FloatArray) -> BoolArray:
        """Return which patches are uninformative; others have the level of their neighbours."""
        alone = is_uninformative(probability)
        if self.neighbours_decide and not alone.all():
            return np.zeros_like(alone)
        return alone
