"""Likelihood of small patches, which resolve depth edges better than the model's."""

from weakref import WeakKeyDictionary

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray, PerPatch, constant
from coded_aperture_ros.depth.levels import Folding
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import Cost, Likelihood
from coded_aperture_ros.likelihood.bank import FilterBank, relearn_bank

# Side of the small patches, px: most PSFs still fit in.
SMALL_PX = 32
# Small bank of each bank: learning takes a second, and settings change more often.
_LEARNED: WeakKeyDictionary[FilterBank, FilterBank] = WeakKeyDictionary()


def small_bank(bank: FilterBank) -> FilterBank:
    """Bank of small patches, for the sizes of a bank's levels without sign.

    It is learned once for a bank.
    """
    if bank not in _LEARNED:
        _LEARNED[bank] = relearn_bank(bank, SMALL_PX, Folding.from_sizes(bank.blur_sizes_px).far)
    return _LEARNED[bank]


def keep_small_bank(bank: FilterBank, small: FilterBank) -> None:
    """Store the small bank of a bank, if it was learned before."""
    _LEARNED[bank] = small


def small_cost(
    small: Likelihood, observation: Observation, grey: FloatArray, noise: PerPatch
) -> Cost:
    """Cost of every blur size for every small patch of a frame, or of a mean of frames.

    Parameters
    ----------
    small : Likelihood
        Planned by the `small_bank`, with patches every `CELL_PX`.
    observation : Observation
        Of the frame.
    grey : ndarray, float32 [height, width]
    noise : float, or ndarray, float32 [rows, columns]
        Standard deviation of the noise of `grey`, of the whole frame or around every patch of the
        model.
    """
    nearest = _nearest_patches(observation.grid, small.grid)
    if isinstance(noise, np.ndarray):
        noise = np.ascontiguousarray(noise[nearest])
    usable = observation.usable
    rows, columns = (constant(index, usable) for index in nearest)
    return small.cost(grey, noise, usable[rows, columns])


def _nearest_patches(of: PatchGrid, to: PatchGrid) -> tuple[IndexArray, ...]:
    """Patch of one grid that is nearest to every patch of another, as an open mesh."""
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
