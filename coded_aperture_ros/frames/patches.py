"""Windows of a frame: their positions, brightness, means and usable pixels."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray, constant, filters
from coded_aperture_ros.core.errors import InputError

# Largest share of unusable pixels of a window with depth.
_MAX_UNUSABLE_SHARE = 0.02
# Side of the blocks that means are made of, px.
_BLOCK_PX = 4


@dataclasses.dataclass(frozen=True)
class PatchGrid:
    """Positions of the windows of a frame.

    Attributes
    ----------
    top, left : int
        First row and column of the first window, px.
    stride_px : int
        Distance between windows, px.
    rows, columns : int
        Number of windows.
    window_px : int
        Side of a window, px.

    Examples
    --------
    >>> grid = PatchGrid.covering((120, 160), window_px=48, stride_px=8)
    >>> grid.rows, grid.columns, int(grid.row_centres[0])
    (10, 15, 24)
    """

    top: int
    left: int
    stride_px: int
    rows: int
    columns: int
    window_px: int

    @classmethod
    def covering(cls, shape: tuple[int, ...], window_px: int, stride_px: int) -> "PatchGrid":
        """Grid of as many windows as fit into a frame of `shape` (rows, columns, ...), centred.

        Raises
        ------
        InputError
            If the frame is smaller than one window.
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

    def every(self, step: int) -> "PatchGrid":
        """Grid of every `step`-th window along rows and columns, from the first on."""
        return dataclasses.replace(
            self,
            stride_px=step * self.stride_px,
            rows=-(-self.rows // step),
            columns=-(-self.columns // step),
        )

    @property
    def row_centres(self) -> IndexArray:
        """Pixel row of the centre of each row of windows [rows]."""
        return self.top + self.window_px // 2 + self.stride_px * np.arange(self.rows)

    @property
    def column_centres(self) -> IndexArray:
        """Pixel column of the centre of each column of windows [columns]."""
        return self.left + self.window_px // 2 + self.stride_px * np.arange(self.columns)

    def centre_values(self, values: FloatArray, cell_px: int = 1) -> FloatArray:
        """Values at the centre of every window [rows, columns].

        Parameters
        ----------
        values : ndarray, float32 [height, width]
            Map of the frame.
        cell_px : int
            Side of a cell of the map, px of the frame.
        """
        rows = np.minimum(self.row_centres // cell_px, len(values) - 1)
        columns = np.minimum(self.column_centres // cell_px, values.shape[1] - 1)
        return values[constant(rows[:, None], values), constant(columns, values)]


def usable_windows(unusable: BoolArray, grid: PatchGrid) -> BoolArray:
    """Mask of the windows with few enough unusable pixels [rows, columns].

    Examples
    --------
    >>> grid = PatchGrid.covering((64, 64), window_px=32, stride_px=32)
    >>> unusable = np.zeros((64, 64), bool)
    >>> unusable[:20, :20] = True
    >>> usable_windows(unusable, grid).tolist()
    [[False, True], [True, True]]
    """
    # Most weight of the Hann window is within half its side around the centre.
    side = grid.window_px // 2
    share = filters(unusable).blur(unusable * np.float32(1), (side, side))
    return grid.centre_values(share) <= _MAX_UNUSABLE_SHARE


def window_brightness(grey: FloatArray, grid: PatchGrid) -> FloatArray:
    """Mean brightness around the centre of every window of a grid [rows, columns].

    Examples
    --------
    >>> grid = PatchGrid.covering((64, 64), window_px=32, stride_px=32)
    >>> window_brightness(np.full((64, 64), 0.5, np.float32), grid).tolist()
    [[0.5, 0.5], [0.5, 0.5]]
    """
    return window_means(grey, grid, grid.window_px // 2)


def window_means(values: FloatArray, grid: PatchGrid, side_px: int) -> FloatArray:
    """Mean of a map of the frame over a square around every window's centre [rows, columns]."""
    # Blocks of the frame first, which is faster: the squares are much larger.
    scale = 1 / _BLOCK_PX
    cv, side = filters(values), max(side_px // _BLOCK_PX, 1)
    blocks = cv.resize(values, None, fx=scale, fy=scale, interpolation=cv.INTER_AREA)
    return grid.centre_values(cv.blur(blocks, (side, side)), _BLOCK_PX)
