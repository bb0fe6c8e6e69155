"""Look-up of blur sizes and depths by NumPy, where there is no numba, and for tensors."""

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, constant, namespace

# Entries per level in the tables of blur size and depth: finer than any estimate.
STEPS = 128
Maps = tuple[FloatArray, ...]


def look_up_plain(
    level: FloatArray, deviation: FloatArray, unknown: BoolArray, tables: Maps, maps: Maps
) -> None:
    """Form of `look_up` for NumPy, and for tensors."""
    xp = namespace(level)
    entry = xp.clip(xp.asarray(level * STEPS + 0.5, dtype=xp.int64), 0, len(tables[0]) - 1)
    sizes, depths, per_level = (constant(table, level)[entry] for table in tables)
    for target, values in zip(maps, (level, sizes, depths, per_level * deviation), strict=True):
        target[:] = xp.where(unknown, np.nan, values)
