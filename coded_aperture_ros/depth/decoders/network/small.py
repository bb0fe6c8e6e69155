"""Likelihood of small patches, which resolve depth edges better than the model's."""

from weakref import WeakKeyDictionary

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray, IndexArray, PerPatch
from coded_aperture_ros.depth.decoders.network.features import LARGEST_PX
from coded_aperture_ros.depth.levels import Folding
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood import Cost, Likelihood, LikelihoodModel
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
    return small.cost(grey, noise, observation.usable[nearest])


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


# Ranges that the network was trained for, px.
_WINDOWS_PX = (32, 72)
_STRIDES_PX = (4, 12)
_LARGEST_STEP_PX = 0.8
# Differences of sizes in steps of 0.8 px may be a little more.
_ROUNDING_PX = 1e-6
_LEAST_SPAN_PX = 3.0


def unsupported_reason(model: LikelihoodModel, stride_px: int) -> str:
    """Why the network was not trained for a model; empty if it was."""
    if not isinstance(model, FilterBank):
        return "it is not a filter bank"
    if reason := _unsupported_blur(model):
        return reason
    for name, value, (low, high) in (
        ("window", model.window_px, _WINDOWS_PX),
        ("stride", stride_px, _STRIDES_PX),
    ):
        if not low <= value <= high:
            return f"its {name} of {value} px is not within {low} to {high} px"
    return ""


def small_patches_bank(model: LikelihoodModel, stride_px: int) -> FilterBank | None:
    """Bank of the small patches that the network needs; None where it was not trained."""
    if not isinstance(model, FilterBank) or unsupported_reason(model, stride_px):
        return None
    return small_bank(model)


def _unsupported_blur(bank: FilterBank) -> str:
    """Why the network was not trained for a bank's blur sizes and PSFs; empty if it was."""
    stack = bank.stack
    if not stack.in_pixels:
        return "the blur sizes of its PSFs are not known in pixels"
    sizes_px = np.abs(stack.blur_sizes_px)
    largest = float(sizes_px.max())
    if largest > LARGEST_PX + _ROUNDING_PX:
        return f"its blur of {largest:.3g} px is above {LARGEST_PX:g} px"
    step = float(np.abs(np.diff(stack.blur_sizes_px)).max())
    if step > _LARGEST_STEP_PX + _ROUNDING_PX:
        return f"its levels are up to {step:.3g} px apart, more than {_LARGEST_STEP_PX:g} px"
    span = float(np.ptp(sizes_px))
    if span < _LEAST_SPAN_PX - _ROUNDING_PX:
        return f"its blur sizes span {span:.3g} px, less than {_LEAST_SPAN_PX:g} px"
    if stack.psfs.shape[-1] > SMALL_PX:
        return f"its PSFs of {stack.psfs.shape[-1]} px do not fit patches of {SMALL_PX} px"
    return ""
