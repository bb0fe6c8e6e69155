"""The windows of a frame, and what is known of each: brightness, means, usable pixels."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError

# A window with more than this share of unusable pixels gives no depth.
_TOLERATED = 0.02
_BLOCK_PX = 4


@dataclasses.dataclass(frozen=True)
class PatchGrid:
    """Where the windows of a frame lie.

    Attributes
    ----------
    top, left : int
        First row and column of the first window.
    stride_px : int
        Distance between windows.
    rows, columns : int
        Number of windows.
    window_px : int
        Side of a window.
    """

    top: int
    left: int
    stride_px: int
    rows: int
    columns: int
    window_px: int

    @classmethod
    def covering(cls, shape: tuple[int, ...], window_px: int, stride_px: int) -> "PatchGrid":
        """Centre as many windows as fit into a frame of `shape` (rows, columns, ...).

        An `InputError` if it is smaller than one window.
        """
        height, width = shape[:2]
        if height < window_px or width < window_px:
            raise InputError(
                f"image of {width}x{height} px is smaller than the bank's {window_px} px window: "
                "use a larger image, or learn a bank with a smaller window"
            )
        spare_rows, spare_columns = height - window_px, width - window_px
        return cls(
            top=spare_rows % stride_px // 2,
            left=spare_columns % stride_px // 2,
            stride_px=stride_px,
            rows=spare_rows // stride_px + 1,
            columns=spare_columns // stride_px + 1,
            window_px=window_px,
        )

    @property
    def row_centres(self) -> IndexArray:
        """Pixel row of the centre of each row of windows."""
        return self.top + self.window_px // 2 + self.stride_px * np.arange(self.rows)

    @property
    def column_centres(self) -> IndexArray:
        """Pixel column of the centre of each column of windows."""
        return self.left + self.window_px // 2 + self.stride_px * np.arange(self.columns)

    def centre_values(self, values: FloatArray, cell_px: int = 1) -> FloatArray:
        """Return a map of the frame, by cells of so many pixels, at the centre of every window."""
        rows = np.minimum(self.row_centres // cell_px, len(values) - 1)
        columns = np.minimum(self.column_centres // cell_px, values.shape[1] - 1)
        return values[np.ix_(rows, columns)]


def usable_windows(unusable: BoolArray, grid: PatchGrid) -> BoolArray:
    """Return which windows of a grid have few enough unusable pixels [rows, columns]."""
    # The Hann window's weight is within half its side around the centre, for the most part.
    side = grid.window_px // 2
    share = cv2.boxFilter(unusable.astype(np.float32), -1, (side, side))
    return grid.centre_values(share) <= _TOLERATED


def window_brightness(grey: FloatArray, grid: PatchGrid) -> FloatArray:
    """Return the mean brightness around the centre of every window of a grid [rows, columns]."""
    return window_means(grey, grid, grid.window_px // 2)


def window_means(values: FloatArray, grid: PatchGrid, side_px: int) -> FloatArray:
    """Return the mean of a map of the frame's size over a square around every window's centre."""
    # Blocks of the frame first: the squares are much larger than they are.
    scale = 1 / _BLOCK_PX
    blocks = cv2.resize(values, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    side = max(side_px // _BLOCK_PX, 1)
    return grid.centre_values(cv2.blur(blocks, (side, side)), _BLOCK_PX)
