"""Resampling between the grid of patches and depth maps, without mixing across depth edges."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray, Shape, namespace
from coded_aperture_ros.frames import PatchGrid

# Levels: where the four patches around a pixel differ by more, there is a depth edge between them,
# and they are not averaged.
_ONE_SURFACE = 3.0
# Pixels of the frame, between two patches, for which the map has one pixel: a finer map would show
# nothing more.
_MAP_PX_PER_PATCH = 5


@dataclasses.dataclass(frozen=True, eq=False)
class MapGrid:
    """Positions of a map's pixels among the patches; the map covers the whole frame.

    Attributes
    ----------
    grid : PatchGrid
    frame_shape : (int, int)
        Rows and columns of the frame.
    size : (int, int)
        Rows and columns of the map.
    patches : (ndarray, ndarray), intp [map rows], [map columns]
        Row of the patch nearest to every row of the map, and column to every column.
    """

    grid: PatchGrid
    frame_shape: tuple[int, ...]
    size: Shape
    patches: tuple[IndexArray, IndexArray]

    @classmethod
    def for_map(cls, grid: PatchGrid, frame_shape: tuple[int, ...], size: Shape) -> "MapGrid":
        """Grid of a map of `size` (rows, columns)."""
        rows, columns = (
            np.rint(_positions(*axis)).astype(np.intp) for axis in _axes(grid, frame_shape, size)
        )
        return cls(grid, frame_shape, size, (rows, columns))

    @classmethod
    def for_resolvable_map(
        cls, grid: PatchGrid, frame_shape: tuple[int, ...], size: Shape
    ) -> "MapGrid":
        """Grid of a map of `size`, but no finer than the patches resolve."""
        finest = -(-np.array(frame_shape) // max(grid.stride_px // _MAP_PX_PER_PATCH, 1))
        resolvable = (min(size[0], int(finest[0])), min(size[1], int(finest[1])))
        return cls.for_map(grid, frame_shape, resolvable)

    @property
    def scale(self) -> float:
        """Pixels of the map per pixel of the frame."""
        return self.size[1] / self.frame_shape[1]

    def interpolate(self, level: FloatArray) -> FloatArray:
        """Level of every pixel [map rows, map columns], from the levels of the patches.

        Bilinear between four patches of one surface; at depth edges, and beyond the outermost patch
        centres, the level of the nearest patch.
        """
        axes = _axes(self.grid, self.frame_shape, self.size)
        (in_rows, down), (in_columns, across) = (_between(*axis) for axis in axes)
        four = np.ones((2, 2), np.uint8)  # every patch and those below, beside and across
        low, high = (extreme(level, four, anchor=(0, 0)) for extreme in (cv2.erode, cv2.dilate))
        one_surface = (high - low <= _ONE_SURFACE).view(np.uint8)
        first = level.take(in_columns, axis=1)
        first += across * np.diff(level, axis=1, append=level[:, -1:]).take(in_columns, axis=1)
        interpolated = np.diff(first, axis=0, append=first[-1:]).take(in_rows, axis=0)
        interpolated *= down[:, None]
        interpolated += first.take(in_rows, axis=0)
        on_one = one_surface.take(in_columns, axis=1).take(in_rows, axis=0)
        return np.asarray(cv2.copyTo(interpolated, on_one, self.nearest_patch_values(level)))

    def nearest_patch_values(self, values: NDArray) -> NDArray:
        """Value of the nearest patch at every pixel [map rows, map columns, ...]."""
        rows, columns = self.patches
        xp = namespace(values)
        return xp.take(xp.take(values, columns, axis=1), rows, axis=0)

    def values_at_patches(self, values: NDArray) -> NDArray:
        """Value of a map at the centre of every patch [grid rows, grid columns]."""
        axes = _axes(self.grid, self.frame_shape, self.size)
        rows, columns = (centres * length // whole for centres, whole, length in axes)
        xp = namespace(values)
        return xp.take(xp.take(values, rows, axis=0), columns, axis=1)


def _axes(
    grid: PatchGrid, frame_shape: tuple[int, ...], size: Shape
) -> tuple[tuple[IndexArray, int, int], tuple[IndexArray, int, int]]:
    """Patch centres [px], length of the frame and of the map, for rows and for columns."""
    return (
        (grid.row_centres, frame_shape[0], size[0]),
        (grid.column_centres, frame_shape[1], size[1]),
    )


def _positions(centres: IndexArray, frame_length: int, length: int) -> DoubleArray:
    """Fractional patch index of every pixel of one axis of the map [length]."""
    scale = frame_length / length
    return np.interp((np.arange(length) + 0.5) * scale - 0.5, centres, np.arange(len(centres)))


def _between(centres: IndexArray, frame_length: int, length: int) -> tuple[IndexArray, FloatArray]:
    """First of the two patches around every pixel of an axis, and the weight of the second."""
    fractional = _positions(centres, frame_length, length)
    first = np.minimum(fractional.astype(np.intp), max(len(centres) - 2, 0))
    return first, (fractional - first).astype(np.float32)
