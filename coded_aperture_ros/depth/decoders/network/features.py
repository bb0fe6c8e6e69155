"""Input of the network: costs resampled to fixed blur sizes, and the frame's texture."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, filters, namespace
from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.depth.decoders.network.cells import Cells
from coded_aperture_ros.depth.decoders.semi_global import semi_global_cost
from coded_aperture_ros.frames import PatchGrid, window_brightness
from coded_aperture_ros.likelihood import Cost

# Fixed blur sizes of the network, px, on one side of the focal plane.
BLUR_STEP_PX = 0.5
LARGEST_PX = 22.0
BLUR_SIZES_PX = np.arange(0, LARGEST_PX + BLUR_STEP_PX / 2, BLUR_STEP_PX)
# Value of a blur size that was not tried, in each of its channels: the logarithm of its cost, of
# the cost scaled up, and of the sum by semi-global matching.
UNTRIED_VALUES = (5.0, 2.8, 5.0)
UNTRIED = UNTRIED_VALUES[0]
KINDS = len(UNTRIED_VALUES)
# Largest cost, natural logarithm.
_MOST_COST = 140.0
# Factor of the cost in the second channel: with little texture costs differ little, but those of
# many patches together are informative.
_FINE_SCALE = 30.0
# Sizes of patches: the model's, and a smaller one.
N_SCALES = 2
COST_CHANNELS = N_SCALES * KINDS * len(BLUR_SIZES_PX)
# Other channels: misfit of both patch sizes, where the model has patches, texture over noise,
# brightness, and the side of the focal plane.
SCALARS = N_SCALES + 4
# Side of the squares whose pixels are the channels of the frame's texture, px; and half the side of
# the box that the mean and variance are over.
FRAME_CELL_PX = 4
_SMOOTH_PX = 9


def tried_sizes(sizes_px: DoubleArray) -> BoolArray:
    """Which of `BLUR_SIZES_PX` lie within the range of a model's blur sizes [L]."""
    sizes, margin = np.abs(sizes_px), BLUR_STEP_PX / 2
    return (sizes.min() - margin <= BLUR_SIZES_PX) & (sizes.max() + margin >= BLUR_SIZES_PX)


def resampling(sizes_px: DoubleArray) -> FloatArray:
    """Linear interpolation weights from a model's levels to the tried blur sizes [L, tried]."""
    sizes = np.abs(sizes_px)
    order = np.argsort(sizes)
    index = np.arange(len(sizes))
    place = np.interp(BLUR_SIZES_PX[tried_sizes(sizes)], sizes[order], index)
    weights = np.maximum(1 - np.abs(place - index[:, None]), 0)
    return np.asarray(weights[np.argsort(order)], np.float32)


@dataclasses.dataclass(frozen=True, eq=False)
class PatchScale:
    """Cost of the patches of one size, and where they lie."""

    volume: FloatArray  # [grid rows, grid columns, L]; cost of every level; see `Cost`
    misfit: FloatArray  # [grid rows, grid columns]; see `Cost`
    grid: PatchGrid  # where the patches lie

    @classmethod
    def from_cost(
        cls, cost: Cost, grid: PatchGrid, volume: FloatArray | None = None
    ) -> "PatchScale":
        """Scale of a cost, or of its misfit and another volume."""
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
    def from_frame(cls, grey: FloatArray, noise: float) -> "LocalContext":
        """Context of a frame [height, width] whose noise has a standard deviation."""
        cv, side = filters(grey), (2 * _SMOOTH_PX + 1,) * 2
        mean = cv.blur(grey, side)
        difference = grey - mean
        return cls(grey, mean, cv.blur(difference * difference, side), noise)


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
    cost_channels = features[:COST_CHANNELS].reshape(N_SCALES, KINDS, -1, cells.rows, cells.columns)
    for kind, untried in enumerate(UNTRIED_VALUES):
        cost_channels[:, kind, :start] = cost_channels[:, kind, stop:] = untried

    def add_scale(index: int, _: int) -> None:
        scale, count = scales[index], len(sizes_px)
        path_sums = semi_global_cost(scale.volume, 1.0, window_brightness(context.grey, scale.grid))
        levels = np.moveaxis(scale.volume, -1, 0).reshape(count, -1)
        channels = log_costs(levels, path_sums.reshape(-1, count).T)
        values = (to_sizes @ channels).reshape(KINDS, -1, *scale.misfit.shape)
        cost_channels[index, :, start:stop] = cells.resample_patches(values, scale.grid)[0]
        features[COST_CHANNELS + index], known = cells.resample_patches(scale.misfit, scale.grid)
        if index == 0:
            features[COST_CHANNELS + N_SCALES] = known

    (workers or Workers()).each(add_scale, range(N_SCALES))
    features[-3], features[-2] = texture_and_brightness(context, cells)
    features[-1] = near
    return features


def log_costs(levels: FloatArray, path_sums: FloatArray) -> FloatArray:
    """Channels of the costs of levels [L, n] and of the sums along paths [KINDS, L, n]."""
    xp = namespace(levels)
    channels: FloatArray = xp.stack([levels, levels, path_sums])
    xp.clip(channels[0], None, _MOST_COST, out=channels[0])
    xp.multiply(channels[0], _FINE_SCALE, out=channels[1])
    channels[2] -= xp.amin(channels[2], 0)
    channels += 1
    xp.log(channels, out=channels)
    channels[1] *= 1 / 3
    return channels


def texture_and_brightness(context: LocalContext, cells: Cells) -> tuple[FloatArray, FloatArray]:
    """Logarithms of the texture over noise and of the brightness of every cell."""
    xp, cv, shape = namespace(context.mean), filters(context.mean), (cells.columns, cells.rows)
    mean, variance = (
        cv.resize(cells.pad_frame(part), shape, interpolation=cv.INTER_AREA)
        for part in (context.mean, context.variance)
    )
    return xp.log(variance / context.noise**2 + 1) / 2, xp.log(xp.clip(mean, 1e-3, None))


def frame_features(context: LocalContext, cells: Cells) -> FloatArray:
    """Texture of the frame, float32 [FRAME_CELL_PX ** 2, rows, columns], a channel per pixel.

    It is relative to the texture around it and the noise.
    """
    xp = namespace(context.grey)
    spread = xp.sqrt(context.variance + 4 * context.noise**2)
    whole = cells.pad_frame((context.grey - context.mean) / spread)
    side = FRAME_CELL_PX
    rows, columns = (length // side for length in whole.shape)
    squares = xp.moveaxis(whole.reshape(rows, side, columns, side), (1, 3), (0, 1))
    texture: FloatArray = squares.reshape(side * side, rows, columns)
    return texture
