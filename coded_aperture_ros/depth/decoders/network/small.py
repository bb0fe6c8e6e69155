"""The likelihood of small patches, beside that of the model's: they see edges more sharply."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray, PerPatch
from coded_aperture_ros.depth.folding import Folding
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import Cost, Likelihood
from coded_aperture_ros.likelihood.bank import FilterBank, relearned

# Side of the small patches: most blur still fits in.
SMALL_PX = 32


def small_bank(bank: FilterBank) -> FilterBank:
    """Return the bank of the small patches, for the sizes of a bank's levels without sign."""
    return relearned(bank, SMALL_PX, Folding.of(bank.blur_sizes_px).far)


def small_cost(small: Likelihood, seen: Observation, grey: FloatArray, noise: PerPatch) -> Cost:
    """Return the cost of every blur size for every small patch of a frame, or of a mean of frames.

    `small` is planned by the `small_bank`, with patches every `CELL_PX`. The `noise` of `grey` is
    that of the frame, or that around every patch of the model [rows, columns].
    """
    nearest = _nearest(seen.grid, small.grid)
    if isinstance(noise, np.ndarray):
        noise = np.ascontiguousarray(noise[nearest])
    return small.cost(grey, noise, seen.usable[nearest])


def _nearest(of: PatchGrid, to: PatchGrid) -> tuple[IndexArray, ...]:
    """Return the patch of one grid that is nearest to every patch of another."""
    rows, columns = (
        np.rint((np.asarray(wanted) - centres[0]) / of.stride_px)
        .clip(0, len(centres) - 1)
        .astype(np.intp)
        for centres, wanted in (
            (of.row_centres, to.row_centres),
            (of.column_centres, to.column_centres),
        )
    )
    return np.ix_(rows, columns)
