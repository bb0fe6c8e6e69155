"""Which windows of a frame show two surfaces, by the true blur sizes of its pixels."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.depth.decoders.network import CELL_PX
from coded_aperture_ros.depth.decoders.network.features import BLUR_SIZES_PX, BLUR_STEP_PX

BINS = len(BLUR_SIZES_PX)
_WINDOW_PX, _EVERY = 48, 2  # pixels that are counted: one in so many, in both directions
# Two surfaces: this share of the window at least is of each, and hardly anything in between; one:
# less than the other share is. What lies between, or mostly beyond the frame, is neither.
_TWO, _ONE, _BETWEEN = 0.06, 0.02, 0.01
_LEAST_APART_PX, _LEAST_KNOWN = 2.0, 0.35
UNCLEAR = -1


@dataclasses.dataclass(frozen=True, eq=False)
class Windows:
    """What windows around cells of 8 px show; all [rows, columns]."""

    two: NDArray[np.int8]  # 1: two surfaces, 0: one, or `UNCLEAR`
    less_px: FloatArray  # blur sizes, without sign, of the less and of the more blurred of two
    more_px: FloatArray
    share: FloatArray  # of the less blurred one


def shares(blur_px: FloatArray, weight: FloatArray) -> FloatArray:
    """Return how much of the window around each cell has each blur size [sizes, rows, columns].

    Parameters
    ----------
    blur_px : ndarray, float32 [height, width]
        Without sign; NaN where it is not known.
    weight : ndarray, float32 [height, width]
        How much of each pixel has it, 0 to 1.
    """
    some = blur_px[::_EVERY, ::_EVERY]
    known = np.isfinite(some)
    counted = np.where(known, weight[::_EVERY, ::_EVERY], 0).astype(np.float32)
    bins = np.rint(np.where(known, some, 0) / BLUR_STEP_PX).clip(0, BINS - 1)
    side = _WINDOW_PX // _EVERY
    # Windows begin at these pixels, of what has half a window added around.
    rows, columns = (
        (CELL_PX * np.arange(length // CELL_PX) + CELL_PX // 2) // _EVERY
        for length in blur_px.shape
    )
    found = np.zeros((BINS, len(rows), len(columns)), np.float32)
    for size in np.unique(bins[known]).astype(int):
        of_size = np.pad(np.where(bins == size, counted, 0), side // 2)
        sums = cv2.boxFilter(of_size, -1, (side, side), anchor=(0, 0), normalize=False)
        found[size] = sums[np.ix_(rows, columns)] / side**2
    return found


def surfaces(found: FloatArray) -> Windows:
    """Return what windows show of which blur sizes take these `shares`."""
    known = found.sum(axis=0)
    found = found / np.maximum(known, 1e-6)
    up_to = np.cumsum(found, axis=0)
    least = np.zeros(known.shape, np.float32)
    gap = np.zeros(known.shape, np.intp)
    for middle in range(2, BINS - 2):
        empty = found[middle - 1 : middle + 2].sum(axis=0) < _BETWEEN
        smaller = np.where(empty, np.minimum(up_to[middle - 1], 1 - up_to[middle]), 0)
        gap = np.where(smaller > least, middle, gap)
        least = np.maximum(least, smaller)
    bins = np.arange(BINS)[:, None, None]
    less, more = (_most_common(np.where(side, found, 0)) for side in (bins < gap, bins > gap))
    two = np.where(least >= _TWO, 1, np.where(least < _ONE, 0, UNCLEAR))
    two[(known < _LEAST_KNOWN) | ((two == 1) & (more - less < _LEAST_APART_PX))] = UNCLEAR
    share = np.take_along_axis(up_to, np.maximum(gap - 1, 0)[None], axis=0)[0]
    return Windows(two.astype(np.int8), less, more, share)


def at_middles(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return a map's values [height, width] in the middles of cells [rows, columns]."""
    rows, columns = (_middles(length) for length in values.shape)
    return values[np.ix_(rows, columns)]


def _middles(length: int) -> IndexArray:
    return CELL_PX * np.arange(length // CELL_PX) + CELL_PX // 2


def _most_common(found: FloatArray) -> FloatArray:
    """Return the mean blur size around that of which there is most."""
    padded = np.pad(found, ((1, 1), (0, 0), (0, 0)))
    best = (padded[:-2] + padded[1:-1] + padded[2:]).argmax(axis=0)
    around = best + np.arange(3)[:, None, None]
    weights = np.take_along_axis(padded, around, axis=0)
    sizes = BLUR_STEP_PX * (around - 1)
    mean = (weights * sizes).sum(axis=0) / np.maximum(weights.sum(axis=0), 1e-6)
    return np.asarray(mean, np.float32)
