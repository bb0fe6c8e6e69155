"""Input of the network: hypotheses in cells of 4 x 4 pixels, and maps beside them."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, Shape

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
        values = np.pad(values, ((0, 0), (0, down), (0, right)), mode="edge")
    parts = values.reshape(
        count, values.shape[1] // CELL_PX, CELL_PX, values.shape[2] // CELL_PX, CELL_PX
    )
    return np.ascontiguousarray(parts.transpose(0, 2, 4, 1, 3)).reshape(
        count * CELL_PX**2, parts.shape[1], parts.shape[3]
    )


def unpack_cells(values: FloatArray, shape: Shape) -> FloatArray:
    """Image of `shape` from its cells [16, rows / 4, columns / 4]."""
    _, rows, columns = values.shape
    parts = values.reshape(CELL_PX, CELL_PX, rows, columns).transpose(2, 0, 3, 1)
    return parts.reshape(CELL_PX * rows, CELL_PX * columns)[: shape[0], : shape[1]]


def mean_and_contrast(frame_cells: FloatArray, noise: float) -> tuple[FloatArray, FloatArray]:
    """Local mean and contrast of the frame's cells [16, rows, columns], each [rows, columns]."""
    side = (_CONTRAST_CELLS, _CONTRAST_CELLS)
    mean = cv2.blur(frame_cells.mean(axis=0), side, borderType=cv2.BORDER_REFLECT)
    power = np.mean((frame_cells - mean) ** 2, axis=0)
    power = cv2.blur(power, side, borderType=cv2.BORDER_REFLECT)
    scale = np.sqrt(power + np.float32((_MIN_SCALE * noise) ** 2) + np.float32(1e-8))
    return mean, scale


def cell_maps(
    sizes: list[FloatArray], known: BoolArray, scale: FloatArray, noise: float
) -> FloatArray:
    """Maps [MAPS, rows, columns] beside the hypotheses of `hypothesis_blur_sizes`."""
    size = scale.shape[::-1]

    def small(values: FloatArray) -> FloatArray:
        down, right = (-length % _SQUARE_PX for length in values.shape)
        if down or right:
            values = cv2.copyMakeBorder(values, 0, down, 0, right, cv2.BORDER_REPLICATE)
        return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA))

    blur = [small(each) / np.float32(_BLUR_UNIT_PX) for each in sizes[:3]]
    strength = np.log10(np.float32(noise) / scale) + 1
    return np.stack([*blur, small(known.astype(np.float32)), strength])
