"""Look-up of blur sizes and depths by NumPy, where there is no numba."""

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray

# Entries per level in the tables of blur size and depth: finer than any estimate.
STEPS = 128
Maps = tuple[FloatArray, ...]


def look_up_plain(
    level: FloatArray, deviation: FloatArray, unknown: BoolArray, tables: Maps, maps: Maps
) -> None:
    """Form of `look_up` for NumPy."""
    entry = (level * STEPS + np.float32(0.5)).astype(np.int32)
    sizes, depths, per_level = (table.take(entry, mode="clip") for table in tables)
    for target, values in zip(maps, (level, sizes, depths, per_level * deviation), strict=True):
        np.copyto(target, np.where(unknown, np.float32(np.nan), values))
