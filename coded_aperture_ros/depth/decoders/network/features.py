"""Input of the network: costs on a grid of blur sizes of its own, and the frame."""

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network.cells import Cells
from coded_aperture_ros.depth.decoders.semi_global import semi_global_cost
from coded_aperture_ros.frames import PatchGrid, window_brightness
from coded_aperture_ros.likelihood import Cost

# The refinement's own grid of blur sizes, on one side of the focal plane.
BLUR_STEP_PX = 0.5
LARGEST_PX = 22.0
BLUR_SIZES_PX = np.arange(0, LARGEST_PX + BLUR_STEP_PX / 2, BLUR_STEP_PX)
# Every blur size has a channel of each kind: the logarithm of its cost, of small differences of
# it, and of the cost that semi-global matching adds up; and what stands there if it was not tried.
_UNTRIED = (5.0, 2.8, 5.0)
UNTRIED = _UNTRIED[0]
KINDS = len(_UNTRIED)
_MOST_COST = 140.0
# Where there is little texture costs differ little, but those of many patches tell something.
_FINE_SCALE = 30.0
# Patches have two sizes: the model's, and a smaller one.
N_SCALES = 2
COST_CHANNELS = N_SCALES * KINDS * len(BLUR_SIZES_PX)
# Beside them: the misfit of both, where there are patches of the model, texture over noise,
# brightness, and the side of the focal plane.
SCALARS = N_SCALES + 4
# The frame's texture is looked at in squares of so many pixels: its channels.
FRAME_CELL_PX = 4
_SMOOTH_PX = 9


def tried_sizes(sizes_px: DoubleArray) -> BoolArray:
    """Return which of `BLUR_SIZES_PX` lie among a model's blur sizes [L], of one side."""
    sizes, margin = np.abs(sizes_px), BLUR_STEP_PX / 2
    return (sizes.min() - margin <= BLUR_SIZES_PX) & (sizes.max() + margin >= BLUR_SIZES_PX)


def resampling(sizes_px: DoubleArray) -> FloatArray:
    """Return the linear weights of a model's levels for every tried blur size [L, tried]."""
    sizes = np.abs(sizes_px)
    order = np.argsort(sizes)
    index = np.arange(len(sizes))
    place = np.interp(BLUR_SIZES_PX[tried_sizes(sizes)], sizes[order], index)
    weights = np.maximum(1 - np.abs(place - index[:, None]), 0)
    return np.asarray(weights[np.argsort(order)], np.float32)


@dataclasses.dataclass(frozen=True, eq=False)
class PatchScale:
    """Cost of the patches of one size."""

    volume: FloatArray  # [grid rows, grid columns, L]; cost of every level; see `Cost`
    misfit: FloatArray  # [grid rows, grid columns]; see `Cost`
    grid: PatchGrid  # where the patches lie

    @classmethod
    def of(cls, cost: Cost, grid: PatchGrid, volume: FloatArray | None = None) -> "PatchScale":
        """Scale of a cost, with its own volume or another."""
        volume = cost.volume if volume is None else volume
        misfit = np.zeros(volume.shape[:2], np.float32) if cost.misfit is None else cost.misfit
        return cls(volume, misfit, grid)


@dataclasses.dataclass(frozen=True, eq=False)
class LocalContext:
    """Mean and variance of a frame around every pixel [height, width], and its noise."""

    grey: FloatArray
    mean: FloatArray
    variance: FloatArray
    noise: float

    @classmethod
    def of(cls, grey: FloatArray, noise: float) -> "LocalContext":
        """Context of a frame whose noise has a standard deviation."""
        side = (2 * _SMOOTH_PX + 1,) * 2
        mean = cv2.blur(grey, side)
        difference = grey - mean
        return cls(grey, mean, cv2.blur(difference * difference, side), noise)


def cost_features(
    scales: Sequence[PatchScale],
    context: LocalContext,
    cells: Cells,
    sizes_px: DoubleArray,
    near: float,
    workers: Workers | None = None,
) -> FloatArray:
    """Features of every cell, float32 [COST_CHANNELS + SCALARS, rows, columns].

    Parameters
    ----------
    scales : sequence of PatchScale
        The model's patches, and the smaller ones.
    context : LocalContext
        Of the frame.
    cells : Cells
    sizes_px : ndarray [L]
        Blur size of every level, of one side.
    near : float
        1 for a scene before the focal plane, 0 beyond it, 0.5 if that is not known.
    workers : Workers, optional
        Threads that share the work.
    """
    tried = np.flatnonzero(tried_sizes(sizes_px))
    start, stop = int(tried[0]), int(tried[-1]) + 1
    to_sizes = resampling(sizes_px).T
    features = np.empty((COST_CHANNELS + SCALARS, cells.rows, cells.columns), np.float32)
    of_kinds = features[:COST_CHANNELS].reshape(N_SCALES, KINDS, -1, cells.rows, cells.columns)
    for kind, untried in enumerate(_UNTRIED):
        of_kinds[:, kind, :start] = of_kinds[:, kind, stop:] = untried

    def add_scale(index: int, _: int) -> None:
        scale, count = scales[index], len(sizes_px)
        added_up = semi_global_cost(scale.volume, 1.0, window_brightness(context.grey, scale.grid))
        found = np.empty((KINDS, count, scale.misfit.size), np.float32)
        levels = np.moveaxis(scale.volume, -1, 0).reshape(count, -1)
        np.minimum(levels, np.float32(_MOST_COST), out=found[0])
        np.multiply(found[0], np.float32(_FINE_SCALE), out=found[1])
        found[2] = added_up.reshape(-1, count).T
        found[2] -= found[2].min(axis=0)
        found += np.float32(1)
        np.log(found, out=found)
        found[1] *= np.float32(1 / 3)
        values = (to_sizes @ found).reshape(KINDS, -1, *scale.misfit.shape)
        of_kinds[index, :, start:stop] = cells.resample_patches(values, scale.grid)[0]
        features[COST_CHANNELS + index], known = cells.resample_patches(scale.misfit, scale.grid)
        if index == 0:
            features[COST_CHANNELS + N_SCALES] = known

    (workers or Workers()).each(add_scale, range(N_SCALES))
    shape = cells.columns, cells.rows
    mean, variance = (
        cv2.resize(cells.pad_frame(part), shape, interpolation=cv2.INTER_AREA)
        for part in (context.mean, context.variance)
    )
    rest = features[COST_CHANNELS + N_SCALES + 1 :]
    rest[0] = np.log(variance / np.float32(context.noise**2) + 1) / 2
    rest[1] = np.log(np.maximum(mean, np.float32(1e-3)))
    rest[2] = near
    return features


def frame_features(context: LocalContext, cells: Cells) -> FloatArray:
    """Return the frame's texture in squares of `FRAME_CELL_PX`, a channel for every pixel of them.

    The texture is relative to its surroundings' and the noise; float32 [channels, rows, columns].
    """
    spread = np.sqrt(context.variance + np.float32(4 * context.noise**2))
    whole = cells.pad_frame((context.grey - context.mean) / spread)
    side = FRAME_CELL_PX
    rows, columns = (length // side for length in whole.shape)
    squares = whole.reshape(rows, side, columns, side).transpose(1, 3, 0, 2)
    return np.ascontiguousarray(squares.reshape(side * side, rows, columns))
