"""Input of the network: hypotheses in cells of 4 x 4 pixels, and maps beside them."""

import numpy as np

from coded_aperture_ros.core.arrays import (
    BoolArray,
    FloatArray,
    Shape,
    constant,
    filters,
    namespace,
)

CELL_PX = 4
# Frames are extended to whole squares of two by two cells.
_SQUARE_PX = 2 * CELL_PX
# Beside the hypotheses' pixels: blur sizes of the pixel, nearest and farthest surface beside it,
# how much of it is known, and how strong the noise is.
MAPS = 5
_CONTRAST_CELLS = 9
# Of the scale that everything is divided by, in standard deviations of the noise.
_MIN_SCALE = 4.0
_BLUR_UNIT_PX = 10.0


def pack_cells(values: FloatArray) -> FloatArray:
    """Images [n, rows, columns] as cells [n * 16, rows / 4, columns / 4]; edges are repeated."""
    count, rows, columns = values.shape
    down = -rows % _SQUARE_PX
    right = -columns % _SQUARE_PX
    if down or right:
        row = np.minimum(np.arange(rows + down), rows - 1)[:, None]
        column = np.minimum(np.arange(columns + right), columns - 1)
        values = values[:, constant(row, values), constant(column, values)]
    parts = values.reshape(
        count, values.shape[1] // CELL_PX, CELL_PX, values.shape[2] // CELL_PX, CELL_PX
    )
    cells = namespace(values).moveaxis(parts, (2, 4), (1, 2))
    packed: FloatArray = cells.reshape(count * CELL_PX**2, parts.shape[1], parts.shape[3])
    return packed


def unpack_cells(values: FloatArray, shape: Shape) -> FloatArray:
    """Image of `shape` from its cells [16, rows / 4, columns / 4]."""
    _, rows, columns = values.shape
    parts = values.reshape(CELL_PX, CELL_PX, rows, columns)
    pixels = namespace(values).moveaxis(parts, (0, 1), (1, 3))
    image: FloatArray = pixels.reshape(CELL_PX * rows, CELL_PX * columns)
    return image[: shape[0], : shape[1]]


def mean_and_contrast(frame_cells: FloatArray, noise: float) -> tuple[FloatArray, FloatArray]:
    """Local mean and contrast of the frame's cells [16, rows, columns], each [rows, columns]."""
    xp, cv, side = namespace(frame_cells), filters(frame_cells), (_CONTRAST_CELLS, _CONTRAST_CELLS)
    mean = cv.blur(frame_cells.mean(axis=0), side, borderType=cv.BORDER_REFLECT)
    power = ((frame_cells - mean) ** 2).mean(axis=0)
    power = cv.blur(power, side, borderType=cv.BORDER_REFLECT)
    return mean, xp.sqrt(power + (float(_MIN_SCALE * noise) ** 2 + 1e-8))


def cell_maps(
    sizes: list[FloatArray], known: BoolArray, scale: FloatArray, noise: float
) -> FloatArray:
    """Maps [MAPS, rows, columns] beside the hypotheses of `hypothesis_blur_sizes`."""
    xp, cv, size = namespace(scale), filters(scale), (scale.shape[1], scale.shape[0])

    def small(values: FloatArray) -> FloatArray:
        down, right = (-length % _SQUARE_PX for length in values.shape)
        if down or right:
            values = cv.copyMakeBorder(values, 0, down, 0, right, cv.BORDER_REPLICATE)
        resized: FloatArray = cv.resize(values, size, interpolation=cv.INTER_AREA)
        return resized

    blur = [small(each) / _BLUR_UNIT_PX for each in sizes[:3]]
    strength = xp.log10(float(noise) / scale) + 1
    maps: FloatArray = xp.stack([*blur, small(known * xp.ones_like(sizes[0])), strength])
    return maps
