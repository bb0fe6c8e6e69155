"""Square cells that cover a frame, which the network works on."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray, Shape, filters, namespace
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.depth.decoders.network import array_forms
from coded_aperture_ros.frames import PatchGrid

# Distance between cells, px; patches at other distances are interpolated.
CELL_PX = 8
# Times that the network halves the cells' rows and columns.
HALVINGS = 2


@dataclasses.dataclass(frozen=True)
class Cells:
    """Square cells that cover a frame; where there are patches, one around each centre."""

    # First pixel row and column of the first cell; 0 or less, as the cells cover the frame.
    top: int
    left: int
    # Number of cells, a multiple of ``2**HALVINGS``.
    rows: int
    columns: int
    frame_shape: Shape  # rows and columns of the frame
    grid: PatchGrid  # where the patches lie

    @classmethod
    def covering(cls, frame_shape: tuple[int, ...], grid: PatchGrid) -> "Cells":
        """Cells of a frame whose patches lie on `grid`."""
        height, width = frame_shape[:2]
        top, rows = _axis(int(grid.row_centres[0]), height)
        left, columns = _axis(int(grid.column_centres[0]), width)
        return cls(top, left, rows, columns, (height, width), grid)

    def resample_patches(
        self, values: FloatArray, grid: PatchGrid
    ) -> tuple[FloatArray, FloatArray]:
        """Values of the patches at the cells, and which cells have patches.

        Parameters
        ----------
        values : ndarray, float32 [..., grid rows, grid columns]
        grid : PatchGrid
            Of these patches.

        Returns
        -------
        values : ndarray, float32 [..., rows, columns]
            Beyond the outermost patches, those of the nearest.
        known : ndarray, float32 [rows, columns]
            1 where there are patches, else 0.
        """
        rows = _inside(grid.row_centres, self.top)
        columns = _inside(grid.column_centres, self.left)
        first = grid.row_centres[0] - self.top, grid.column_centres[0] - self.left
        if grid.stride_px != CELL_PX or any(at % CELL_PX != CELL_PX // 2 for at in first):
            across = _interpolation(grid.column_centres, self.left, columns)
            down = _interpolation(grid.row_centres, self.top, rows)
            values = np.asarray(down @ values @ across.T, np.float32)
        at_cells = np.empty((*values.shape[:-2], self.rows, self.columns), np.float32)
        within = at_cells[..., rows, :]
        within[..., columns] = values
        # Beyond the outermost patches their values go on.
        within[..., : columns.start] = values[..., :1]
        within[..., columns.stop :] = values[..., -1:]
        at_cells[..., : rows.start, :] = within[..., :1, :]
        at_cells[..., rows.stop :, :] = within[..., -1:, :]
        known = np.zeros((self.rows, self.columns), np.float32)
        known[rows, columns] = 1
        return at_cells, known

    def pad_frame(self, picture: FloatArray) -> FloatArray:
        """Picture [height, width] extended to the outline of the cells, by mirroring."""
        height, width = self.frame_shape
        bottom = self.top + self.rows * CELL_PX - height
        right = self.left + self.columns * CELL_PX - width
        cv, margins = filters(picture), (-self.top, bottom, -self.left, right)
        padded: FloatArray = cv.copyMakeBorder(picture, *margins, cv.BORDER_REFLECT)
        return padded


def _inside(centres: IndexArray, first: int) -> slice:
    """Cells of an axis whose centres lie between the first and last patch's centre."""
    before, after = (int(centre) - CELL_PX // 2 - first for centre in centres[[0, -1]])
    start = -(-before // CELL_PX)
    # A few patches close together may have no cell's middle among them: then the next one.
    return slice(start, max(after // CELL_PX, start) + 1)


def _axis(centre: int, length: int) -> tuple[int, int]:
    """First pixel of the first cell of an axis, and number of cells that cover the frame."""
    start = centre - CELL_PX // 2
    before = -(-start // CELL_PX)
    top = start - before * CELL_PX
    count = -(-(length - top) // CELL_PX)
    multiple = 2**HALVINGS
    return top, -(-count // multiple) * multiple


def _interpolation(centres: IndexArray, first: int, cells: slice) -> FloatArray:
    """Linear interpolation weight of every patch for every cell of an axis [cells, patches]."""
    at = first + CELL_PX * np.arange(cells.start, cells.stop) + CELL_PX // 2
    place = np.interp(at, centres, np.arange(len(centres)))
    return np.maximum(1 - np.abs(place[:, None] - np.arange(len(centres))), 0).astype(np.float32)


HALF_CELL_PX = CELL_PX // 2
# Largest difference of two values.
_ANY = float(np.finfo(np.float32).max)


@dataclasses.dataclass(frozen=True, eq=False)
class Drawing:
    """Rendering of cells' values as maps of a size that cover the whole frame.

    Attributes
    ----------
    cells : Cells
    size : (int, int)
        Rows and columns of the maps.
    quarters : ndarray, int [2 rows, 2 columns]
        Half-cell whose value each quarter of a half-cell has; see `Guide.owners`.
    """

    cells: Cells
    size: Shape
    quarters: IndexArray

    @property
    def pixel_px(self) -> float:
        """Side of a pixel of the maps, in pixels of the frame."""
        height, width = self.cells.frame_shape
        return max(height / self.size[0], width / self.size[1])

    def render_map(self, values: FloatArray, one_surface: float = _ANY) -> FloatArray:
        """Map of half-cells' values [rows, columns].

        Linear within a surface, where neighbours differ by at most `one_surface`; elsewhere every
        quarter of a half-cell has the value of the half-cell that was chosen for it.
        """
        cells = self.cells
        whole = upsample_half_cells(
            values, self.quarters, one_surface, cells.frame_shape, (-cells.top, -cells.left)
        )
        return self._resized(whole)

    def upsample_nearest(self, values: FloatArray) -> FloatArray:
        """Map of cells' values [rows, columns], in squares."""
        xp, (height, width) = namespace(values), self.cells.frame_shape
        whole = xp.repeat(xp.repeat(values, CELL_PX, axis=0), CELL_PX, axis=1)
        whole = whole[-self.cells.top :, -self.cells.left :][:height, :width]
        return self._resized(xp.ascontiguousarray(whole))

    def _resized(self, whole: FloatArray) -> FloatArray:
        """Map of the frame at the size of the maps."""
        if whole.shape == self.size:
            return whole
        cv = filters(whole)
        resized: FloatArray = cv.resize(
            whole, self.size[::-1], interpolation=cv.INTER_NEAREST_EXACT
        )
        return resized


def upsample_half_cells(
    values: FloatArray,
    quarters: IndexArray,
    one_surface: float,
    shape: Shape | None = None,
    first: Shape = (0, 0),
) -> FloatArray:
    """Half-cells' values at pixels; see `Drawing.render_map`.

    By default at every pixel of the half-cells, otherwise at so many rows and columns from the
    first ones on.
    """
    if shape is None:
        shape = HALF_CELL_PX * values.shape[0], HALF_CELL_PX * values.shape[1]
    cv = filters(values)
    bordered = cv.copyMakeBorder(values, 1, 1, 1, 1, cv.BORDER_REPLICATE)
    if cv is not cv2:
        whole = array_forms.drawn(bordered, quarters, one_surface)
        return whole[first[0] :, first[1] :][: shape[0], : shape[1]]
    drawn = np.empty(shape, np.float32)
    draw(bordered, quarters, np.float32(one_surface), first, drawn)
    return drawn


def _draw_loop(
    values: FloatArray,
    quarters: IndexArray,
    one_surface: np.float32,
    first: Shape,
    drawn: FloatArray,
) -> None:
    columns, flat = values.shape[1] - 2, values.ravel()
    low, high = np.empty(columns + 2, np.float32), np.empty(columns + 2, np.float32)
    line = np.empty(columns + 2, np.float32)
    even, pixels = np.empty(columns, np.bool_), np.empty((columns, HALF_CELL_PX), np.float32)
    near, far = np.float32(0.625), np.float32(0.875)  # weights by distance from the middle
    for y in range(len(drawn)):
        i, down = divmod(first[0] + y, HALF_CELL_PX)
        if y == 0 or down == 0:
            for j in range(columns + 2):
                a, b, c = values[i, j], values[i + 1, j], values[i + 2, j]
                low[j], high[j] = min(min(a, b), c), max(max(a, b), c)
            for j in range(columns):
                least = min(min(low[j], low[j + 1]), low[j + 2])
                even[j] = max(max(high[j], high[j + 1]), high[j + 2]) - least <= one_surface
        weight = near if down in (0, 3) else far
        beside = i if down < 2 else i + 2
        for j in range(columns + 2):
            line[j] = weight * values[i + 1, j] + (1 - weight) * values[beside, j]
        for j in range(columns):
            before, here, after = line[j], line[j + 1], line[j + 2]
            pixels[j, 0] = near * here + (1 - near) * before
            pixels[j, 1] = far * here + (1 - far) * before
            pixels[j, 2] = far * here + (1 - far) * after
            pixels[j, 3] = near * here + (1 - near) * after
        for j in range(columns):
            if not even[j]:
                pixels[j, :2] = flat[quarters[2 * i + down // 2, 2 * j]]
                pixels[j, 2:] = flat[quarters[2 * i + down // 2, 2 * j + 1]]
        drawn[y] = pixels.ravel()[first[1] : first[1] + drawn.shape[1]]


# Writes the map of half-cells' values with a border of one, see `Drawing.render_map`, from a first
# row and column on.
draw = Compiled(_draw_loop, array_forms.draw_plain)
