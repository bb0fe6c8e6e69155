"""Comparison of two frames along the lines of sight by NumPy, where there is no numba."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.depth.moving.fusion_plain import Maps
from coded_aperture_ros.depth.moving.geometry import Transfer, Way

# Step to either side along the line of sight, px of parallax, of which the best match is found: a
# second search from there followed noise, and brought half as much.
STEP_PX = 1.0
# The farthest step, as a share of the inverse depth, or of this inverse depth, 1/m, if it is less.
FARTHEST = 0.3
LEAST_STEP_FROM = 0.05
# Least parallax, px by 1/m.
LEAST_PX_PER = 1e-2
# Window within which the depth is one, px of the map, and how many of its pixels tell something of
# their own.
WINDOW_PX = 9
INDEPENDENT = 0.3 * WINDOW_PX**2
# What was believed before holds the search as if it were four times as uncertain, and 5 % at least.
LOOSER = 4.0
TOLERANCE = 0.05
# Differences that a shift of this much would explain are no misfit, px; and how fast trust falls
# with the misfit, and the most there is.
SHIFT_PX = 0.25
MISFIT_SCALE = 2.0
MOST_CONFIDENCE = 0.9
LEAST_INVERSE = 1e-3
# Square roots of light of the present frame and the earlier one [rows, columns].
Pair = tuple[FloatArray, FloatArray]
# Of every pixel: the parallax, px by 1/m, and the step, 1/m.
Scales = tuple[FloatArray, FloatArray]
# Squares of the slope, per px, of it times the difference, of the difference; 1 where outside.
Products = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def compare_plain(
    pair: Pair, way: Way, inverse: FloatArray, scales: Scales, products: Products
) -> None:
    """Form of `compare` for NumPy."""
    transfer, (now, earlier), (px_per, step) = Transfer(way, inverse.shape), pair, scales
    px_per[:] = np.maximum(transfer.parallax(inverse), np.float32(LEAST_PX_PER))
    step[:] = np.float32(FARTHEST) * np.maximum(inverse, np.float32(LEAST_STEP_FROM))
    np.minimum(step, np.float32(STEP_PX) / px_per, out=step)
    padded = np.pad(now, 1, "edge")
    across = (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2
    down = (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2
    here, inside = _shown(earlier, transfer, inverse)
    along = transfer.directions()
    slope = np.where(inside, along[0] * across + along[1] * down, np.float32(0))
    difference = np.where(inside, here - now, np.float32(0))
    values = slope * slope, slope * difference, difference * difference, ~inside
    for target, value in zip(products, values, strict=True):
        target[:] = value


def differ_plain(
    pair: Pair, way: Way, every: int, inverse: FloatArray, found: tuple[FloatArray, FloatArray]
) -> None:
    """Form of `differ` for NumPy."""
    now, earlier = pair
    shown, inside = _shown(earlier, Transfer(way, earlier.shape, every), inverse)
    difference, outside = found
    difference[:] = np.where(inside, shown - now, np.float32(0))
    outside[:] = ~inside


def _shown(
    earlier: FloatArray, transfer: Transfer, inverse: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """The earlier frame where each pixel's point is in it, and where that is inside."""
    column, row = transfer.columns_rows(inverse)
    shown = cv2.remap(earlier, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    rows, columns = earlier.shape
    inside = (column >= 0) & (column < columns - 1) & (row >= 0) & (row < rows - 1)
    return shown, inside


def judge_plain(
    means: Products,
    scales: Scales,
    believed: tuple[FloatArray, FloatArray],
    limits: tuple[np.float32, np.float32],
    found: Maps,
) -> None:
    """Form of `judge` for NumPy."""
    (squares, covaried, left, hidden), (px_per, step) = means, scales
    (inverse, uncertain), (noise, finest_px) = believed, limits
    change = -covaried / (np.maximum(squares, np.float32(1e-9)) * px_per)
    change = np.clip(change, -step, step)
    # Noise has slopes, too.
    told = np.maximum(squares - noise**2 / np.float32(2 * STEP_PX**2), 0)
    told *= np.float32(INDEPENDENT) / noise**2
    told /= 1 + told * finest_px**2
    information = told * np.square(px_per)
    hold = 1 / (np.float32(LOOSER) * uncertain + np.square(np.float32(TOLERANCE) * inverse))
    change *= information / (information + hold)
    found[0][:] = np.maximum(inverse + change, np.float32(LEAST_INVERSE))
    moved_px = change * px_per
    still = np.maximum(left + moved_px * (2 * covaried + moved_px * squares), 0)
    excess = still / (2 * noise**2 + np.float32(SHIFT_PX**2) * squares) - 1
    found[1][:] = 1 / np.maximum(information, np.float32(1e-6))
    tolerated = np.square(np.float32(TOLERANCE) * found[0])
    trust = MOST_CONFIDENCE * np.exp(-np.maximum(excess, 0) / np.float32(MISFIT_SCALE))
    found[2][:] = trust * (1 - hidden) * tolerated / (tolerated + found[1])
