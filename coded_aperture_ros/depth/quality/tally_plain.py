"""Residuals of spectra by frequency and direction, added up without numba, and of tensors."""

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray, namespace

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
    """Form of the tally for NumPy, and for tensors."""
    (radius, vertical, horizontal, sector), (of_rings, of_map) = at, sums
    xp = namespace(residual)
    weights = xp.repeat(weight, len(radius), axis=0)
    # Windows without weight, which only tensors have, do not count.
    values = weights * residual.ravel(), weights, weights > 0
    ring = xp.minimum(_whole(xp.outer(2 * size_px, radius)), RINGS)
    column = xp.minimum(_whole(xp.outer(size_px, horizontal) * MAP_STEPS), MAP_COLUMNS - 1)
    row = _whole(xp.outer(size_px, vertical) * MAP_STEPS + MAP_ROWS // 2)
    in_map = column * MAP_ROWS + xp.clip(row, 0, MAP_ROWS - 1)
    for totals, cell in ((of_rings, ring * SECTORS + sector), (of_map, in_map)):
        for total, value in zip(totals, values[: len(totals)], strict=True):
            total += xp.bincount(cell.ravel(), value, len(total))


def _whole(values: DoubleArray) -> IndexArray:
    """Whole numbers, rounded towards zero."""
    xp = namespace(values)
    return xp.asarray(values, dtype=xp.int64)
