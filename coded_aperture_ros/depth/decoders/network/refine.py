"""Decides levels by a small network that has learned what edges do to cost volumes."""

from functools import partial

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, Shape, as_floats
from coded_aperture_ros.core.stages import Stages
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.classical import Decision
from coded_aperture_ros.depth.decoders.network.cells import CELL_PX, Cells
from coded_aperture_ros.depth.decoders.network.features import (
    BLUR_SIZES_PX,
    BLUR_STEP_PX,
    COST_CHANNELS,
    LARGEST_PX,
    Look,
    Surroundings,
    cost_features,
    frame_features,
    tried_sizes,
)
from coded_aperture_ros.depth.decoders.network.network import Network
from coded_aperture_ros.depth.decoders.network.probabilities import (
    HalfCells,
    chosen_neighbours,
    drawn,
)
from coded_aperture_ros.depth.decoders.network.second import SecondSurface
from coded_aperture_ros.depth.decoders.network.small import SMALL_PX
from coded_aperture_ros.depth.decoders.sides import FocalSides
from coded_aperture_ros.depth.folding import Folding
from coded_aperture_ros.depth.free_space import POWER, SHARE, near_ends
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.temporal import bounded
from coded_aperture_ros.depth.upsample import MapGrid
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import Cost, LikelihoodModel
from coded_aperture_ros.likelihood.bank import FilterBank

# What the network may be used for: about what it was trained for.
_WINDOWS_PX = (32, 72)
_STRIDES_PX = (4, 12)
_LARGEST_STEP_PX = 0.8
_LEAST_SPAN_PX = 3.0
# Neighbouring half-cells whose blur sizes differ by at most this are one surface.
_ONE_SURFACE_PX = 0.8
_PLAUSIBLE = 0.05
# The network knows costs of up to three frames: the sum of all past ones counts by this share.
_OF_THE_PAST = 0.5
# Costs that differ by less are those of a frame without any texture.
_ALIKE = 1e-3


def untrained(model: LikelihoodModel, stride_px: int) -> str:
    """Return why a model is not one that the network was trained for; empty if it is."""
    stack = model.stack
    if not isinstance(model, FilterBank):
        return "it is not a filter bank"
    if not stack.in_pixels:
        return "the blur sizes of its PSFs are not known in pixels"
    largest = float(np.abs(stack.blur_sizes_px).max())
    if largest > LARGEST_PX:
        return f"its blur of {largest:.3g} px is above {LARGEST_PX:g} px"
    step = float(np.abs(np.diff(stack.blur_sizes_px)).max())
    if step > _LARGEST_STEP_PX:
        return f"its levels are up to {step:.3g} px apart, more than {_LARGEST_STEP_PX:g} px"
    span = float(np.ptp(np.abs(stack.blur_sizes_px)))
    if span < _LEAST_SPAN_PX:
        return f"its blur sizes span {span:.3g} px, less than {_LEAST_SPAN_PX:g} px"
    if stack.psfs.shape[-1] > SMALL_PX:
        return f"its PSFs of {stack.psfs.shape[-1]} px do not fit patches of {SMALL_PX} px"
    for name, value, (low, high) in (
        ("window", model.window_px, _WINDOWS_PX),
        ("stride", stride_px, _STRIDES_PX),
    ):
        if not low <= value <= high:
            return f"its {name} of {value} px is not within {low} to {high} px"
    return ""


class Refined:
    """Decides the levels of frames of one size, as `Regularized` does by classical means.

    `untrained` has nothing to say of the bank. On the grid `small` lie the small patches, whose
    cost comes with that of the model's; see `small_cost`. There are `sides` if there are levels on
    both sides of the focal plane. With `second` it can tell of a second surface.
    """

    def __init__(
        self,
        bank: FilterBank,
        levels: Levels,
        small: PatchGrid,
        sides: FocalSides | None = None,
        workers: Workers | None = None,
        runtime: str = "auto",
        second: bool = False,
    ) -> None:
        self._workers = workers or Workers()
        self._sizes = sizes = bank.blur_sizes_px
        self._order = np.argsort(sizes)
        self._levels, self._small, self._sides = levels, small, sides
        self._folding = Folding.of(sizes)
        tried = tried_sizes(self._folding.sizes_px)
        self._tried_px = BLUR_SIZES_PX[tried].astype(np.float32)
        self._network = Network(tried, self._workers, runtime)
        # One that is more blurred may lie before or behind: of two sides nothing is told.
        self._second = SecondSurface(tried) if second and sides is None else None
        self._tolerance = _tolerance_px(levels)
        self._near = 0.5 if sides is not None else float(sizes.mean() < 0)
        self._ends_px = float(sizes.min()), float(sizes.max())
        self._per_px = np.float32((len(sizes) - 1) / np.ptp(sizes))

    def __call__(
        self, seen: Observation, volume: FloatArray, own: Cost, size: Shape, stages: Stages
    ) -> Decision:
        """See `Regularized`."""
        if own.small is None:
            raise ValueError("the cost of the small patches is missing")
        grey = seen.grey
        if volume is not own.volume:  # of a video
            past = volume - bounded(own.volume)
            volume = own.volume + np.float32(_OF_THE_PAST) * past
            volume -= volume.min(axis=-1, keepdims=True)
        cells = Cells.covering(grey.shape, seen.grid)
        looks = (
            Look.of(own, seen.grid, self._folding.of_sizes(volume)),
            Look.of(own.small, self._small),
        )
        sizes_px = self._folding.sizes_px
        around = Surroundings.of(grey, seen.noise.typical)
        costs = cost_features(looks, around, cells, sizes_px, self._near, self._workers)
        logits = self._network(costs, frame_features(around, cells))
        found = HalfCells.of(logits, self._tried_px, self._workers)
        far = self._far(found.size_px, volume, cells)
        signed_px = np.where(far >= 0.5, found.size_px, -found.size_px)
        level = self._level(signed_px)
        tolerance_px = self._tolerance[np.rint(level).astype(np.intp)]
        # One side may reach farther than the other.
        beyond_px = np.abs(signed_px - np.clip(signed_px, *self._ends_px))
        possible = (beyond_px <= BLUR_STEP_PX).astype(np.float32)
        of_side = None
        if self._sides is not None:
            of_side = np.maximum(far, 1 - far)
            # Where both sides' depths are about the same, either is right.
            possible *= np.where(self._sides.agree(level), 1, of_side)
        calibration = self._network.calibration
        probability = found.right_within(tolerance_px)
        right = possible * calibration.confidence(probability, found.size_px, tolerance_px)
        half_px = CELL_PX // 2
        deviation = found.deviation_px() * (self._per_px * calibration.deviation)
        quarters = chosen_neighbours(logits.neighbour)
        stages.lap("refine")

        def map_of(values: FloatArray, one_surface: float) -> FloatArray:
            return cut(drawn(values, quarters, one_surface))

        def in_squares(values: FloatArray) -> FloatArray:
            return cut(np.repeat(np.repeat(values, CELL_PX, axis=0), CELL_PX, axis=1))

        def cut(whole: FloatArray) -> FloatArray:
            whole = whole[-cells.top :, -cells.left :][: grey.shape[0], : grey.shape[1]]
            if whole.shape != size:
                whole = cv2.resize(whole, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
            return np.ascontiguousarray(whole)

        one_surface = _ONE_SURFACE_PX * float(self._per_px)
        level_map, confidence = map_of(level, one_surface), map_of(right, 0.1)
        blank = volume.max() <= _ALIKE  # nothing to go by anywhere
        if blank:
            confidence[:] = 0
        at = MapGrid.of(seen.grid, grey.shape, size)
        if not seen.usable.all():
            confidence[at.nearest(~seen.usable)] = 0

        nearest = np.float32(self._levels.nearest_first[0])

        def free_level(risk: float) -> FloatArray:
            error = max(0.5, BLUR_STEP_PX / 2 * float(self._per_px))
            pixel_px = max(grey.shape[0] / size[0], grey.shape[1] / size[1])
            level = self._level(found.nearest_px(SHARE * risk**POWER, far))
            level = near_ends(level, self._levels, error, half_px, pixel_px)
            # Linear everywhere: what lies between two cells is not beyond what either says alone.
            return np.where(at.nearest(~seen.usable) | blank, nearest, map_of(level, np.inf))

        def nearest_plausible() -> FloatArray:
            if blank:
                return np.full(size, nearest)
            level = self._level(found.nearest_px(_PLAUSIBLE, far))
            # Where nothing was seen anything may be, whatever is around.
            blind = ~seen.usable & (volume.max(axis=-1) <= _ALIKE)
            return np.where(at.nearest(blind), nearest, map_of(level, one_surface))

        def second(surface: SecondSurface) -> tuple[FloatArray, FloatArray]:
            pair = surface(logits, costs[COST_CHANNELS:]).mapped(in_squares)
            sizes_px = np.abs(self._sizes)
            first_px = np.interp(level_map, np.arange(len(sizes_px)), sizes_px)
            size_px, share = pair.beside(as_floats(first_px))
            beyond_px = np.abs(np.clip(size_px, sizes_px.min(), sizes_px.max()) - size_px)
            of_second = self._level(size_px if self._near < 0.5 else -size_px)
            unknown = at.nearest(~seen.usable) | blank | (beyond_px > BLUR_STEP_PX)
            of_second[unknown] = share[unknown] = np.nan
            return of_second, share

        return Decision(
            level_map,
            map_of(deviation, 0.5),
            confidence,
            None if of_side is None else map_of(of_side, 0.1),
            nearest_plausible,
            free_level,
            None if self._second is None else partial(second, self._second),
        )

    def _far(self, size_px: FloatArray, volume: FloatArray, cells: Cells) -> FloatArray:
        """Return how likely every half-cell is beyond the focal plane [rows, columns]."""
        if self._sides is None:
            return np.full(size_px.shape, self._sizes.mean() > 0, np.float32)
        grid, half_px = cells.grid, CELL_PX // 2
        rows, columns = (
            (centres - first) // half_px
            for centres, first in ((grid.row_centres, cells.top), (grid.column_centres, cells.left))
        )
        # A centre is where four half-cells meet.
        means = cv2.blur(size_px, (2, 2), anchor=(1, 1), borderType=cv2.BORDER_REPLICATE)
        beyond = self._level(means[np.ix_(rows, columns)])
        probability = self._sides.confidence(beyond, volume, grid)
        nearest = (
            np.abs(half_px * np.arange(length)[:, None] + first + half_px // 2 - centres).argmin(1)
            for length, first, centres in (
                (size_px.shape[0], cells.top, grid.row_centres),
                (size_px.shape[1], cells.left, grid.column_centres),
            )
        )
        return probability[np.ix_(*nearest)]

    def _level(self, size_px: FloatArray) -> FloatArray:
        """Return the fractional level of signed blur sizes."""
        sizes, order = self._sizes[self._order], self._order
        return np.interp(size_px, sizes, order).astype(np.float32)


def _tolerance_px(levels: Levels) -> FloatArray:
    """Return by how much the blur size of each level may be wrong for 5 % of its depth [L]."""
    sizes = levels.blur_sizes_px
    step_px = abs(np.mean(np.diff(sizes)))
    if levels.depths_m is None:
        return np.full(len(sizes), step_px, np.float32)
    inverse = 1 / levels.depths_m
    per_px = np.abs(np.gradient(inverse, sizes))
    # Levels of infinite depth are alike; some have no depth at all.
    tolerance = np.full(len(sizes), step_px)
    finite = np.isfinite(levels.depths_m) & (per_px > 0)
    return np.divide(0.05 * inverse, per_px, out=tolerance, where=finite).astype(np.float32)
