"""Periodic texture: where it would explain a frame as well as usual texture at another depth.

Blurred texture of one band of frequencies may look like usual texture that is nearly sharp. All
patches of a wall then agree on a wrong level, and neither they nor their neighbours show it.
"""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, constant, filters, namespace
from coded_aperture_ros.depth.layer import LayerSpec
from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.stage import Plan, Stage, Work
from coded_aperture_ros.depth.upsample import MapGrid
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import Cost
from coded_aperture_ros.likelihood.bank.prior import periodic_levels

LAYERS: tuple[LayerSpec, ...] = ()
WHEN = ""
# Confidence at periodic texture: such depth is right about as often as a guess.
CHANCE_CONFIDENCE = 0.2
# Least difference of blur sizes of another depth, px; at least the step between levels.
_APART_PX = 1.5
# Side of the box around a patch, px, and share of the patches in it that have to look periodic:
# near edges single ones do.
_AROUND_PX = 104
_AGREE = 0.75


def make(plan: Plan, config: object) -> Stage:
    """Stage of a plan's levels; it works where the cost knows of periodic texture."""
    return PeriodicTexture(plan.levels)


@dataclasses.dataclass(frozen=True, eq=False)
class PeriodicTexture(Stage):
    """Lowers the confidence where periodic texture at another depth explains the frame as well."""

    levels: Levels
    name = "periodic texture"

    def __call__(self, work: Work) -> None:
        """Compare the cost of the estimated level with that of periodic texture."""
        if work.frame_cost.periodic is None:
            return
        step = work.frame_cost.periodic_step
        some, grid = np.s_[::step, ::step], work.observation.grid.every(step)
        xp, cost = namespace(work.level), work.frame_cost
        cost = dataclasses.replace(cost, volume=cost.volume[some])
        at = MapGrid.for_map(grid, work.observation.grey.shape, work.level.shape)
        periodic = may_be_periodic(
            cost, work.observation.usable[some], at.values_at_patches(work.level), self.levels, grid
        )
        if xp is not np or periodic.any():  # a device is not waited for
            found = at.nearest_patch_values(periodic)
            lowered = xp.minimum(work.confidence, CHANCE_CONFIDENCE)
            work.confidence = xp.where(found, lowered, work.confidence)
            work.doubted |= found


def may_be_periodic(
    cost: Cost, usable: BoolArray, level: FloatArray, levels: Levels, grid: PatchGrid
) -> BoolArray:
    """Patches that periodic texture at another depth explains as well [rows, columns].

    Takes the `cost` of a frame, which patches are `usable`, the estimated fractional level of each
    [rows, columns], and what the levels are.
    """
    assert cost.periodic is not None
    xp, cv, sizes_px = namespace(level), filters(level), levels.blur_sizes_px
    found = xp.abs(xp.interp(level, np.arange(len(sizes_px)), sizes_px))[..., None]
    found = xp.asarray(found, dtype=xp.float32)
    apart = max(_APART_PX, float(np.abs(np.diff(sizes_px)).max()))
    sizes = constant(np.abs(sizes_px).astype(np.float32), level)
    others = sizes[constant(periodic_levels(len(sizes_px)), level)]
    here = xp.amin(xp.where(xp.abs(sizes - found) < apart, cost.volume, np.inf), -1)
    tried = xp.amin(cost.periodic.reshape(*level.shape, -1, len(others)), -2)
    there = xp.amin(xp.where(xp.abs(others - found) < apart, np.inf, tried), -1)
    side = (2 * round(_AROUND_PX / grid.stride_px / 2) + 1,) * 2
    say_so, counted = (
        cv.blur(xp.asarray(each, dtype=xp.float32), side)
        for each in ((there < here) & usable, usable)
    )
    mask: BoolArray = say_so > _AGREE * counted
    return mask
