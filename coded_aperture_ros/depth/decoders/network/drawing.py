"""From values of half-cells to maps of pixels."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray, Shape
from coded_aperture_ros.depth.decoders.network.cells import CELL_PX, Cells

HALF_CELL_PX = CELL_PX // 2


@dataclasses.dataclass(frozen=True, eq=False)
class Drawing:
    """Draws maps of a size that cover the whole frame.

    Attributes
    ----------
    cells : Cells
    size : (int, int)
        Rows and columns of the maps.
    quarters : ndarray, int [2 rows, 2 columns]
        For each quarter of each half-cell, whose value it has; see `chosen_neighbours`.
    """

    cells: Cells
    size: Shape
    quarters: IndexArray

    @property
    def pixel_px(self) -> float:
        """Side of a pixel of the maps, in pixels of the frame."""
        height, width = self.cells.frame_shape
        return max(height / self.size[0], width / self.size[1])

    def render_map(self, values: FloatArray, one_surface: float = np.inf) -> FloatArray:
        """Map of half-cells' values [rows, columns].

        Linear within a surface, where neighbours differ by at most `one_surface`; elsewhere every
        quarter of a half-cell has the value of the half-cell that was chosen for it.
        """
        return self._cropped(upsample_half_cells(values, self.quarters, one_surface))

    def upsample_nearest(self, values: FloatArray) -> FloatArray:
        """Map of cells' values [rows, columns], in squares."""
        return self._cropped(np.repeat(np.repeat(values, CELL_PX, axis=0), CELL_PX, axis=1))

    def _cropped(self, whole: FloatArray) -> FloatArray:
        """Part of a map of the cells that the frame covers, at the size of the maps."""
        height, width = self.cells.frame_shape
        whole = whole[-self.cells.top :, -self.cells.left :][:height, :width]
        if whole.shape != self.size:
            whole = cv2.resize(whole, self.size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
        return np.ascontiguousarray(whole)


def upsample_half_cells(values: FloatArray, quarters: IndexArray, one_surface: float) -> FloatArray:
    """Half-cells' values at every pixel of the cells; see `Drawing.render_map`."""
    pixels = (HALF_CELL_PX * values.shape[1], HALF_CELL_PX * values.shape[0])
    linear = cv2.resize(values, pixels, interpolation=cv2.INTER_LINEAR)
    around = np.ones((3, 3), np.uint8)
    even = (cv2.dilate(values, around) - cv2.erode(values, around) <= one_surface).view(np.uint8)
    even = cv2.resize(even, pixels, interpolation=cv2.INTER_NEAREST)
    bordered = cv2.copyMakeBorder(values, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    edges = cv2.resize(bordered.ravel()[quarters], pixels, interpolation=cv2.INTER_NEAREST)
    return np.where(even.view(bool), linear, edges)
