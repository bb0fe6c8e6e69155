"""Decoder of levels by a small network, trained on simulated cost volumes with depth edges."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import (
    BoolArray,
    DoubleArray,
    FloatArray,
    IndexArray,
    Shape,
    namespace,
)
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network.bilateral import Guide
from coded_aperture_ros.depth.decoders.network.bounds import nearest_level_around, nearest_px
from coded_aperture_ros.depth.decoders.network.cells import HALF_CELL_PX, Cells, Drawing
from coded_aperture_ros.depth.decoders.network.far_side import far_probability
from coded_aperture_ros.depth.decoders.network.features import (
    BLUR_SIZES_PX,
    BLUR_STEP_PX,
    LocalContext,
    PatchScale,
    cost_features,
    frame_features,
    tried_sizes,
)
from coded_aperture_ros.depth.decoders.network.network import Logits, Network
from coded_aperture_ros.depth.decoders.network.probabilities import HalfCells
from coded_aperture_ros.depth.decoders.sides import FocalSides
from coded_aperture_ros.depth.levels import Folding, Levels
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.upsample import MapGrid
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import Cost, bounded_cost

# Largest differences between neighbouring half-cells of one surface: of blur size, px, of
# confidence, and of standard deviation, in levels.
ONE_SURFACE_PX = 0.8
ONE_CONFIDENCE = 0.1
ONE_DEVIATION = 0.5
# Weight of the past frames' cost: the network was trained on costs of up to three frames.
_PAST_WEIGHT = 0.5
# Largest difference of costs, natural logarithm, of a frame without texture.
BLANK_COST = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class SizeScale:
    """Signed blur sizes of a model's levels, equally spaced, and their tolerances.

    Attributes
    ----------
    levels : Levels
    order : ndarray, int [L]
        Levels, ordered by signed blur size.
    tolerance_px : ndarray, float32 [L]
        Error of each level's blur size that is 5 % of its depth.
    """

    levels: Levels
    order: IndexArray
    tolerance_px: FloatArray

    @classmethod
    def from_levels(cls, levels: Levels) -> "SizeScale":
        """Scale of a model's levels."""
        return cls(levels, np.argsort(levels.blur_sizes_px), levels.tolerance_px)

    @property
    def sizes_px(self) -> DoubleArray:
        """Signed blur size of every level [L]."""
        return self.levels.blur_sizes_px

    @property
    def levels_per_px(self) -> np.float32:
        """Levels in a pixel of blur."""
        return np.float32(self.levels.per_px)

    @property
    def is_far(self) -> bool:
        """Whether levels, of one side, are beyond the focal plane."""
        return bool(self.sizes_px.mean() > 0)

    def level(self, size_px: FloatArray) -> FloatArray:
        """Fractional level of signed blur sizes, float32 of their shape."""
        xp = namespace(size_px)
        level = xp.interp(size_px, self.sizes_px[self.order], self.order)
        return xp.asarray(level, dtype=xp.float32)


@dataclasses.dataclass(frozen=True, eq=False)
class NetworkDecoded:
    """Levels decided by the network; see `Decoded`."""

    level: FloatArray
    deviation: FloatArray
    confidence: FloatArray
    side_confidence: FloatArray | None
    logits: Logits
    features: FloatArray  # [COST_CHANNELS + SCALARS, rows, columns]; of every cell
    half_cells: HalfCells
    far: FloatArray  # [rows, columns]; probability of every half-cell to lie beyond the focus
    scale: SizeScale
    drawing: Drawing
    blank: bool  # whether the whole frame has no texture
    # [rows, columns]; confidence of every half-cell that the check of fit has learned with.
    checked: FloatArray
    unusable: BoolArray  # [map rows, map columns]; where no patch is usable
    blind: BoolArray  # where no patch is usable, and past frames have no cost either

    def quantile(self, probability: float) -> FloatArray:
        """See `Decoded.quantile`; the nearest level where nothing was seen."""
        level = self.scale.level(nearest_px(self.half_cells, probability, self.far))
        one_surface = ONE_SURFACE_PX * float(self.scale.levels_per_px)
        # Where nothing was seen, neighbours are no evidence.
        return self._seen(self.blind, self.drawing.render_map(level, one_surface))

    def nearest_around(self, probability: float) -> FloatArray | None:
        """See `Decoded.nearest_around`; the nearest level where nothing was seen."""
        error = max(0.5, BLUR_STEP_PX / 2 * float(self.scale.levels_per_px))
        level = self.scale.level(nearest_px(self.half_cells, probability, self.far))
        level = nearest_level_around(
            level, self.scale.levels, error, HALF_CELL_PX, self.drawing.pixel_px
        )
        # Linear everywhere: a bound between two cells lies between their bounds.
        return self._seen(self.unusable, self.drawing.render_map(level))

    def _seen(self, unseen: BoolArray, level: FloatArray) -> FloatArray:
        """Levels [map rows, map columns]; the nearest one where nothing was seen."""
        nearest = float(self.scale.levels.nearest_first[0])
        return namespace(level).where(unseen | self.blank, nearest, level)


class NetworkDecoder:
    """Decides the levels of frames of one size, as `ClassicalDecoder` does by classical means.

    Parameters
    ----------
    levels : Levels
        Of a model that the network supports; see `unsupported_reason`.
    small : PatchGrid
        Positions of the small patches; see `small_cost`.
    sides : FocalSides, optional
        If there are levels on both sides of the focal plane.
    workers : Workers, optional
        Threads that share the work.
    runtime : str
        What runs the network; see `network_of`.
    own : mapping, optional
        Arrays of its weights, if a bank has its own.
    """

    def __init__(
        self,
        levels: Levels,
        small: PatchGrid,
        sides: FocalSides | None = None,
        workers: Workers | None = None,
        runtime: str = "auto",
        own: Mapping[str, Any] | None = None,
    ) -> None:
        self._workers = workers or Workers()
        self._small = small
        self._sides = sides
        self._scale = SizeScale.from_levels(levels)
        self._folding = Folding.from_sizes(levels.blur_sizes_px)
        self.tried = tried_sizes(self._folding.sizes_px)
        self._tried_px = BLUR_SIZES_PX[self.tried].astype(np.float32)
        self._network = Network(self.tried, self._workers, runtime, own)

    def __call__(
        self, observation: Observation, volume: FloatArray, frame_cost: Cost, size: Shape
    ) -> NetworkDecoded:
        """Decide the level of every pixel; see `ClassicalDecoder` and `inputs`."""
        if volume is not frame_cost.volume:
            volume = limit_past(volume, frame_cost.volume)
        cells = Cells.covering(observation.grey.shape, observation.grid)
        features, frame = self.inputs(observation, volume, frame_cost, cells)
        logits = self._network(features, frame)
        alone = HalfCells.from_logits(logits, self._tried_px, self._workers)
        guide = Guide.from_light(observation.light, cells)
        half_cells = alone.agreed(guide, self._workers)
        far = self._far_probability(half_cells.size_px, volume, cells)
        level, tolerance_px, possible = self._rate(half_cells.size_px, far)
        calibration = self._network.calibration
        confidence = possible * calibration.confidence(half_cells.confidence_features(tolerance_px))
        _, tolerance_px, possible = self._rate(alone.size_px, far)
        checked = possible * self._network.checked.confidence(alone.own_features(tolerance_px))
        deviation = half_cells.deviation_px() * (self._scale.levels_per_px * calibration.deviation)
        drawing = Drawing(cells, size, guide.owners())
        one_surface = ONE_SURFACE_PX * float(self._scale.levels_per_px)
        confidence_map = drawing.render_map(confidence, ONE_CONFIDENCE)
        flat = volume.max(axis=-1) <= BLANK_COST
        blank = bool(flat.all())
        at = MapGrid.for_map(observation.grid, observation.grey.shape, size)
        unusable = at.nearest_patch_values(~observation.usable)
        confidence_map[unusable | blank] = 0
        return NetworkDecoded(
            level=drawing.render_map(level, one_surface),
            deviation=drawing.render_map(deviation, ONE_DEVIATION),
            confidence=confidence_map,
            side_confidence=None
            if self._sides is None
            else drawing.render_map(np.maximum(far, 1 - far), ONE_CONFIDENCE),
            logits=logits,
            features=features,
            half_cells=half_cells,
            far=far,
            scale=self._scale,
            drawing=drawing,
            blank=blank,
            checked=checked,
            unusable=unusable,
            blind=at.nearest_patch_values(~observation.usable & flat),
        )

    def inputs(
        self, observation: Observation, volume: FloatArray, frame_cost: Cost, cells: Cells
    ) -> tuple[FloatArray, FloatArray]:
        """What the network is given of a frame: `cost_features` and `frame_features`.

        Raises
        ------
        ValueError
            If the cost of the small patches is missing.
        """
        if frame_cost.small is None:
            raise ValueError("the cost of the small patches is missing")
        scales = (
            PatchScale.from_cost(frame_cost, observation.grid, self._folding.fold_volume(volume)),
            PatchScale.from_cost(frame_cost.small, self._small),
        )
        context = LocalContext.from_frame(observation.grey, observation.noise.typical)
        sizes_px = self._folding.sizes_px
        features = cost_features(scales, context, cells, sizes_px, self._near_share, self._workers)
        return features, frame_features(context, cells)

    def _rate(
        self, size_px: FloatArray, far: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Level, its tolerance, and how possible blur sizes and sides are; [rows, columns] each."""
        sizes_px = self._scale.sizes_px
        signed_px = np.where(far >= 0.5, size_px, -size_px)
        level = self._scale.level(signed_px)
        tolerance_px = self._scale.tolerance_px[np.rint(level).astype(np.intp)]
        # One side may reach farther than the other.
        beyond_px = np.abs(
            signed_px - np.clip(signed_px, float(sizes_px.min()), float(sizes_px.max()))
        )
        possible = (beyond_px <= BLUR_STEP_PX).astype(np.float32)
        if self._sides is not None:
            # Where both sides' depths are about the same, either is right.
            possible *= np.where(self._sides.is_ambiguous(level), 1, np.maximum(far, 1 - far))
        return level, tolerance_px, possible

    @property
    def _near_share(self) -> float:
        """1 for a scene before the focal plane, 0 beyond it, 0.5 if that is not known."""
        return 0.5 if self._sides is not None else float(not self._scale.is_far)

    def _far_probability(self, size_px: FloatArray, volume: FloatArray, cells: Cells) -> FloatArray:
        """Probability of every half-cell to lie beyond the focal plane [rows, columns]."""
        if self._sides is None:
            return np.full(size_px.shape, self._scale.is_far, np.float32)
        return far_probability(self._sides, self._scale.level, size_px, volume, cells)


def limit_past(volume: FloatArray, of_frame: FloatArray) -> FloatArray:
    """Cost of all frames, with the past weighted as in training [rows, columns, L]."""
    past = volume - bounded_cost(of_frame)
    volume = of_frame + _PAST_WEIGHT * past
    volume -= namespace(volume).amin(volume, -1, keepdims=True)
    return volume
