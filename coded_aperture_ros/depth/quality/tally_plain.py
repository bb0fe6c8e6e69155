"""Residuals of spectra by frequency and direction, added up by NumPy where there is no numba."""

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray

# Rings and sectors of the frequencies, and a map of frequencies times blur sizes, in steps a cycle.
RINGS = 12
SECTORS = 4
MAP_ROWS = 31
MAP_COLUMNS = 15
MAP_STEPS = 2.5
# Frequencies' radius, vertical and horizontal part, and sector; and what is added up by ring, map.
At = tuple[DoubleArray, DoubleArray, DoubleArray, IndexArray]
Sums = tuple[DoubleArray, DoubleArray]


def tally_plain(
    residual: FloatArray, size_px: DoubleArray, weight: DoubleArray, at: At, sums: Sums
) -> None:
    """Form of the tally for NumPy."""
    (radius, vertical, horizontal, sector), (of_rings, of_map) = at, sums
    weights = np.repeat(weight, len(radius))
    values = weights * residual.ravel(), weights, None
    ring = np.minimum(np.outer(2 * size_px, radius).astype(int), RINGS)
    column = np.minimum((np.outer(size_px, horizontal) * MAP_STEPS).astype(int), MAP_COLUMNS - 1)
    row = (np.outer(size_px, vertical) * MAP_STEPS + MAP_ROWS // 2).astype(int)
    in_map = column * MAP_ROWS + np.clip(row, 0, MAP_ROWS - 1)
    for totals, cell in ((of_rings, ring * SECTORS + sector), (of_map, in_map)):
        for total, value in zip(totals, values, strict=False):
            total += np.bincount(cell.ravel(), value, len(total))
