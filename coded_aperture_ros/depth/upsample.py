"""From the coarse grid of patches to a map of the wanted size, without mixing across edges."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray, Shape
from coded_aperture_ros.frames import PatchGrid

# Where the levels of the four patches around a pixel differ by more, there is a depth edge between
# them, and they are not averaged.
_ONE_SURFACE = 3.0
# Patches so far apart, in px, are worth one pixel of the map for each this many.
_MAP_PX_PER_PATCH = 5


@dataclasses.dataclass(frozen=True, eq=False)
class MapGrid:
    """Where the pixels of a map of `size`, which covers the whole frame, lie among its patches.

    `patches` are the row and the column of the patch nearest to every row and column of the map.
    """

    grid: PatchGrid
    frame_shape: tuple[int, ...]
    size: Shape
    patches: tuple[IndexArray, IndexArray]

    @classmethod
    def of(cls, grid: PatchGrid, frame_shape: tuple[int, ...], size: Shape) -> "MapGrid":
        """Return the grid of a map of `size`."""
        rows, columns = (
            np.rint(_positions(*axis)).astype(np.intp) for axis in _axes(grid, frame_shape, size)
        )
        return cls(grid, frame_shape, size, (rows, columns))

    @classmethod
    def worthwhile(cls, grid: PatchGrid, frame_shape: tuple[int, ...], size: Shape) -> "MapGrid":
        """Return the grid of a map that is at most as large as the patches are worth."""
        finest = -(-np.array(frame_shape) // max(grid.stride_px // _MAP_PX_PER_PATCH, 1))
        drawn = (min(size[0], int(finest[0])), min(size[1], int(finest[1])))
        return cls.of(grid, frame_shape, drawn)

    @property
    def scale(self) -> float:
        """Pixels of the map per pixel of the frame."""
        return self.size[1] / self.frame_shape[1]

    def interpolated(self, level: FloatArray) -> FloatArray:
        """Return the map of the patches' levels [rows, columns].

        Between four patches of one surface levels are interpolated bilinearly, across a depth edge
        every pixel takes that of the nearest patch. Beyond the outermost patch centres the nearest
        patch goes on.
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
        return np.asarray(cv2.copyTo(interpolated, on_one, self.nearest(level)))

    def nearest(self, values: NDArray) -> NDArray:
        """Return the value of the nearest patch at every pixel; takes [rows, columns, ...]."""
        rows, columns = self.patches
        return np.take(np.take(values, columns, axis=1), rows, axis=0)

    def at_patches(self, values: NDArray) -> NDArray:
        """Return the map's value at the centre of every patch [rows, columns]."""
        axes = _axes(self.grid, self.frame_shape, self.size)
        return values[np.ix_(*(centres * length // whole for centres, whole, length in axes))]


def _axes(
    grid: PatchGrid, frame_shape: tuple[int, ...], size: Shape
) -> tuple[tuple[IndexArray, int, int], tuple[IndexArray, int, int]]:
    """Return for rows and columns the patches' centres, the frame's length and the map's."""
    return (
        (grid.row_centres, frame_shape[0], size[0]),
        (grid.column_centres, frame_shape[1], size[1]),
    )


def _positions(centres: IndexArray, frame_length: int, length: int) -> DoubleArray:
    """Give the fractional patch index of every output pixel of an axis."""
    scale = frame_length / length
    return np.interp((np.arange(length) + 0.5) * scale - 0.5, centres, np.arange(len(centres)))


def _between(centres: IndexArray, frame_length: int, length: int) -> tuple[IndexArray, FloatArray]:
    """Give the first of the two patches around every output pixel of an axis, and how far on."""
    fractional = _positions(centres, frame_length, length)
    first = np.minimum(fractional.astype(np.intp), max(len(centres) - 2, 0))
    return first, (fractional - first).astype(np.float32)
