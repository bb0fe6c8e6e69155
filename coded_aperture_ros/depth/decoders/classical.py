"""Decoder of levels by classical regularisation, with the confidence of single patches."""

import dataclasses
from functools import partial

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray, Shape
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.edges import EdgeCorrection
from coded_aperture_ros.depth.decoders.posterior import (
    is_uninformative,
    level_confidence,
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

# A side that is no likelier than this is a guess: what is sure of the blur alone (0.9) is then said
# to be right at 0.36 to 0.4, and not published by default.
_UNTOLD = 0.55
_UNTOLD_FACTOR = 0.8


@dataclasses.dataclass(frozen=True, eq=False)
class ClassicalDecoded:
    """Levels decided by a regulariser; see `Decoded`."""

    level: FloatArray
    deviation: FloatArray
    confidence: FloatArray
    side_confidence: FloatArray | None
    probability: FloatArray  # [grid rows, grid columns, L]; of every level of every patch
    nearest_first: IndexArray  # [L]; the levels, ordered by depth
    map_grid: MapGrid

    def quantile(self, probability: float) -> FloatArray:
        """See `Decoded.quantile`."""
        nearest = nearest_plausible_level(self.probability, self.nearest_first, probability)
        return np.asarray(self.map_grid.nearest_patch_values(nearest.astype(np.float32)))

    def nearest_around(self, probability: float) -> FloatArray | None:
        """None: at depth edges the posterior of single patches is too coarse for a bound."""
        return None


@dataclasses.dataclass(frozen=True, eq=False)
class ClassicalDecoder:
    """Regularises levels, corrects foreground fattening, and calibrates the confidence.

    Attributes
    ----------
    levels : Levels
    regularize : Regularizer
    correct_edges : EdgeCorrection
    sides : FocalSides or None
        If there are levels on both sides of the focal plane.
    fills_gaps : bool
        Whether a patch that is uninformative by itself has the level of its neighbours.
    workers : Workers
        Threads that share the work.
    """

    levels: Levels
    regularize: Regularizer
    correct_edges: EdgeCorrection
    sides: FocalSides | None
    fills_gaps: bool
    workers: Workers

    def __call__(
        self, observation: Observation, volume: FloatArray, frame_cost: Cost, size: Shape
    ) -> ClassicalDecoded:
        """Decide the level of every pixel.

        Parameters
        ----------
        observation : Observation
        volume : ndarray, float32 [grid rows, grid columns, L]
            Cost of every level by all frames that count.
        frame_cost : Cost
            By this frame alone, or by the mean of equal frames.
        size : (int, int)
            Most rows and columns of the maps.
        """
        grid = observation.grid
        levels_of_patches = self.regularize(
            volume, frame_cost.volume, observation.brightness, grid.stride_px
        )
        at = MapGrid.for_resolvable_map(grid, observation.grey.shape, size)
        level = self.correct_edges(at.interpolate(levels_of_patches), at.scale)
        probability = level_probability(volume)
        (confidence, side_confidence), deviation = self.workers.both(
            partial(self._confidence, level, levels_of_patches, volume, probability, at),
            partial(self._deviation, level, volume, at),
        )
        uninformative = ~observation.usable | self._gaps(probability)
        if uninformative.any():
            confidence[at.nearest_patch_values(uninformative)] = 0
        return ClassicalDecoded(
            level,
            deviation,
            confidence,
            side_confidence,
            probability,
            self.levels.nearest_first,
            at,
        )

    def _confidence(
        self,
        level: FloatArray,
        levels_of_patches: FloatArray,
        volume: FloatArray,
        probability: FloatArray,
        at: MapGrid,
    ) -> tuple[FloatArray, FloatArray | None]:
        """Probability that each pixel's level is right, and that its side is [rows, columns]."""
        agreement = self.levels.agreement
        if self.sides is None:
            return level_confidence(level, probability, at.patches, agreement), None
        side_confidence = at.nearest_patch_values(
            self.sides.confidence(levels_of_patches, volume, at.grid)
        )
        given_side = self.sides.condition_on_side(probability)
        confidence = level_confidence(level, given_side, at.patches, agreement)
        # Where both sides' depths are about the same, either is right.
        told = np.where(self.sides.is_ambiguous(level), 1, side_confidence)
        confidence *= np.where(told < _UNTOLD, _UNTOLD_FACTOR * told, told)
        return confidence, side_confidence

    def _deviation(self, level: FloatArray, volume: FloatArray, at: MapGrid) -> FloatArray:
        """Standard deviation of each pixel's level given its side, in levels [rows, columns]."""
        if self.sides is None:
            return level_deviation(level, volume, at.patches)
        return self.sides.deviation(level, volume, at.patches)

    def _gaps(self, probability: FloatArray) -> BoolArray:
        """Patches that are uninformative and do not have the level of their neighbours."""
        alone = is_uninformative(probability)
        if self.fills_gaps and not alone.all():
            return np.zeros_like(alone)
        return alone
