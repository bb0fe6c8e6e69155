"""Input of the network, on a device; see `cost_features` and `frame_features`."""

from collections.abc import Sequence

import numpy as np
import torch

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, constant
from coded_aperture_ros.depth.decoders.network.cells import Cells
from coded_aperture_ros.depth.decoders.network.features import (
    BLUR_SIZES_PX,
    KINDS,
    N_SCALES,
    UNTRIED_VALUES,
    LocalContext,
    PatchScale,
    log_costs,
    resampling,
    texture_and_brightness,
    tried_sizes,
)
from coded_aperture_ros.depth.decoders.network.on_device.paths import semi_global_costs
from coded_aperture_ros.frames import PatchGrid, window_brightness


class DeviceFeatures:
    """Features of every cell, for frames of one size and a model's blur sizes of one side.

    Parameters
    ----------
    cells : Cells
    grids : sequence of PatchGrid
        Of the model's patches, and of the smaller ones.
    sizes_px : ndarray [L]
        Blur size of every level, of one side.
    near : float
        1 for a scene before the focal plane, 0 beyond it.
    """

    def __init__(
        self, cells: Cells, grids: Sequence[PatchGrid], sizes_px: DoubleArray, near: float
    ) -> None:
        self._cells, self._grids, self._near = cells, grids, near
        self._to_sizes = np.ascontiguousarray(resampling(sizes_px).T)
        tried = np.flatnonzero(tried_sizes(sizes_px))
        self._tried = slice(int(tried[0]), int(tried[-1]) + 1)
        self._axes = [_to_cells(cells, grid) for grid in grids]
        none = np.zeros((grids[0].rows, grids[0].columns), np.float32)
        self._known = cells.resample_patches(none, grids[0])[1]

    def __call__(self, scales: Sequence[PatchScale], context: LocalContext) -> torch.Tensor:
        """Features [COST_CHANNELS + SCALARS, rows, columns]; see `cost_features`."""
        grey = context.grey
        to_sizes, known = constant(self._to_sizes, grey), constant(self._known, grey)
        path_sums = semi_global_costs(
            [scale.volume for scale in scales],
            [window_brightness(grey, grid) for grid in self._grids],
        )
        volume = _untried(known)
        misfits = []
        for number, (scale, sums) in enumerate(zip(scales, path_sums, strict=True)):
            count, patches = sums.shape[2], scale.misfit.shape
            levels = torch.movedim(scale.volume, 2, 0).reshape(count, -1)
            channels = log_costs(levels, sums.movedim(2, 0).reshape(count, -1))
            down, across = (constant(axis, grey) for axis in self._axes[number])
            at_sizes = (to_sizes @ channels).reshape(KINDS, -1, *patches)
            volume[number, :, self._tried] = down @ at_sizes @ across.T
            misfits.append(down @ scale.misfit @ across.T)
        texture, brightness = texture_and_brightness(context, self._cells)
        near = torch.full_like(brightness, self._near)
        scalars = torch.stack([*misfits, known, texture, brightness, near])
        return torch.cat([volume.flatten(0, 2), scalars])


def _untried(like: torch.Tensor) -> torch.Tensor:
    """Channels of blur sizes that were not tried [scales, kinds, blur sizes, rows, columns]."""
    values = constant(np.array(UNTRIED_VALUES, np.float32)[:, None, None, None], like)
    shape = N_SCALES, KINDS, len(BLUR_SIZES_PX), *like.shape
    return torch.broadcast_to(values, shape).clone()


def _to_cells(cells: Cells, grid: PatchGrid) -> tuple[FloatArray, FloatArray]:
    """Matrices from the patches' rows and columns to those of the cells."""
    columns = np.eye(grid.columns, dtype=np.float32)[:, None].repeat(grid.rows, 1)
    rows = np.eye(grid.rows, dtype=np.float32)[:, :, None].repeat(grid.columns, 2)
    across = cells.resample_patches(columns, grid)[0][:, 0]
    down = cells.resample_patches(rows, grid)[0][:, :, 0]
    return np.ascontiguousarray(down.T), np.ascontiguousarray(across.T)
