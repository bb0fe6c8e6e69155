"""What the refinement looks at: the costs on a grid of blur sizes of its own, and the frame."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.depth.refine.cells import CELL_PX, Cells

# The refinement's own grid of blur sizes, of both sides of the focal plane.
BLUR_STEP_PX = 0.5
LARGEST_PX = 22.0
BLUR_SIZES_PX = np.arange(-LARGEST_PX, LARGEST_PX + BLUR_STEP_PX / 2, BLUR_STEP_PX)
# What stands for the logarithm of the cost of blur sizes that were not tried.
_UNTRIED = 5.0
_MOST_COST = 140.0
# Beside the costs: the misfit, where there are patches, texture over noise, and brightness.
SCALARS = 4
# The frame's texture is looked at in squares of so many pixels: its channels.
FRAME_CELL_PX = 4
_SMOOTH_PX = 9


def tried_sizes(sizes_px: DoubleArray) -> BoolArray:
    """Return which of `BLUR_SIZES_PX` lie among a model's blur sizes [L]."""
    margin = BLUR_STEP_PX / 2
    return (sizes_px.min() - margin <= BLUR_SIZES_PX) & (sizes_px.max() + margin >= BLUR_SIZES_PX)


def resampling(sizes_px: DoubleArray) -> FloatArray:
    """Return the linear weights of a model's levels for every tried blur size [L, tried]."""
    order = np.argsort(sizes_px)
    index = np.arange(len(sizes_px))
    place = np.interp(BLUR_SIZES_PX[tried_sizes(sizes_px)], sizes_px[order], index)
    weights = np.maximum(1 - np.abs(place - index[:, None]), 0)
    return np.asarray(weights[np.argsort(order)], np.float32)


def cost_features(
    volume: FloatArray,
    misfit: FloatArray,
    grey: FloatArray,
    noise: float,
    cells: Cells,
    sizes_px: DoubleArray,
) -> FloatArray:
    """Return what is known of every cell.

    Parameters
    ----------
    volume : ndarray, float32 [grid rows, grid columns, L]
        Cost of every level; see `Cost`.
    misfit : ndarray, float32 [grid rows, grid columns]
        See `Cost`.
    grey : ndarray, float32 [height, width]
        The frame, linear light.
    noise : float
        Standard deviation of its noise.
    sizes_px : ndarray, float64 [L]
        Signed blur size of every level.

    Returns
    -------
    ndarray, float32 [blur sizes + SCALARS, rows, columns]
    """
    tried = tried_sizes(sizes_px)
    logarithm = np.log1p(np.minimum(volume, np.float32(_MOST_COST))) @ resampling(sizes_px)
    values = np.concatenate([logarithm, misfit[..., None]], axis=-1)
    at_cells, known = cells.of_patches(values)
    features = np.full(
        (len(BLUR_SIZES_PX) + SCALARS, cells.rows, cells.columns), _UNTRIED, np.float32
    )
    count = len(BLUR_SIZES_PX)
    features[:count][tried] = at_cells[:-1]
    features[count] = at_cells[-1]
    features[count + 1] = known
    mean, deviation = (_of_cells(cells.of_frame(picture)) for picture in _statistics(grey))
    features[count + 2] = np.log(deviation / np.float32(noise**2) + 1) / 2
    features[count + 3] = np.log(np.maximum(mean, np.float32(1e-3)))
    return features


def frame_features(grey: FloatArray, noise: float, cells: Cells) -> FloatArray:
    """Return the frame's texture in squares of `FRAME_CELL_PX`, a channel for every pixel of them.

    Takes the frame [height, width]. The texture is relative to its surroundings' and the noise;
    float32 [channels, rows, columns].
    """
    mean, variance = _statistics(grey)
    texture = (grey - mean) / np.sqrt(variance + np.float32(4 * noise**2))
    whole = cells.of_frame(texture)
    side = FRAME_CELL_PX
    rows, columns = (length // side for length in whole.shape)
    squares = whole.reshape(rows, side, columns, side).transpose(1, 3, 0, 2)
    return np.ascontiguousarray(squares.reshape(side * side, rows, columns))


def _statistics(grey: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean and the variance around every pixel."""
    side = (2 * _SMOOTH_PX + 1,) * 2
    mean = cv2.blur(grey, side)
    difference = grey - mean
    return mean, cv2.blur(difference * difference, side)


def _of_cells(picture: FloatArray) -> FloatArray:
    rows, columns = (length // CELL_PX for length in picture.shape)
    return np.asarray(cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA))
