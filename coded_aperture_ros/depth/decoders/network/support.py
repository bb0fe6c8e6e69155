"""Which models the network may decide for: about those that it was trained for."""

import numpy as np

from coded_aperture_ros.depth.decoders.network.features import LARGEST_PX
from coded_aperture_ros.depth.decoders.network.small import SMALL_PX, small_bank
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.likelihood.bank import FilterBank

_WINDOWS_PX = (32, 72)
_STRIDES_PX = (4, 12)
_LARGEST_STEP_PX = 0.8
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
    stack = bank.stack
    if not stack.in_pixels:
        return "the blur sizes of its PSFs are not known in pixels"
    sizes_px = np.abs(stack.blur_sizes_px)
    largest = float(sizes_px.max())
    if largest > LARGEST_PX:
        return f"its blur of {largest:.3g} px is above {LARGEST_PX:g} px"
    step = float(np.abs(np.diff(stack.blur_sizes_px)).max())
    if step > _LARGEST_STEP_PX:
        return f"its levels are up to {step:.3g} px apart, more than {_LARGEST_STEP_PX:g} px"
    span = float(np.ptp(sizes_px))
    if span < _LEAST_SPAN_PX:
        return f"its blur sizes span {span:.3g} px, less than {_LEAST_SPAN_PX:g} px"
    if stack.psfs.shape[-1] > SMALL_PX:
        return f"its PSFs of {stack.psfs.shape[-1]} px do not fit patches of {SMALL_PX} px"
    return ""
