"""What stands where depth is unknown: nothing, or the nearest depth that is plausible."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.depth.levels import Levels
from coded_aperture_ros.depth.posterior import nearest_plausible_level
from coded_aperture_ros.depth.upsample import MapGrid

# From a map of levels, where they are unsure, the patches' probabilities [rows, columns, L], the
# levels and the map's grid, to the levels that are shown and where these are unknown all the same.
UnknownRule = Callable[
    [NDArray[np.float32], NDArray[np.bool_], NDArray[np.float32], Levels, MapGrid],
    tuple[NDArray[np.float32], NDArray[np.bool_] | None],
]


def withhold(
    level: NDArray[np.float32],
    unsure: NDArray[np.bool_],
    probability: NDArray[np.float32],
    levels: Levels,
    at: MapGrid,
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """Leave depth unknown wherever it is unsure."""
    return level, unsure


def assume_nearest(
    level: NDArray[np.float32],
    unsure: NDArray[np.bool_],
    probability: NDArray[np.float32],
    levels: Levels,
    at: MapGrid,
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """Take the nearest plausible level wherever it is unsure, so that nothing is run into."""
    nearest = at.nearest(nearest_plausible_level(probability, levels.nearest_first))
    return np.where(unsure, levels.nearer(level, nearest.astype(np.float32)), level), None


UNKNOWN_RULES: dict[str, UnknownRule] = {"nothing": withhold, "nearest": assume_nearest}
