"""Where the network was trained, and so whether the network or a regulariser decides levels."""

import dataclasses

import numpy as np

from coded_aperture_ros.depth.decoders.network.features import LARGEST_PX
from coded_aperture_ros.depth.decoders.network.small import SMALL_PX
from coded_aperture_ros.depth.decoders.regularize import LEARNED
from coded_aperture_ros.likelihood import LikelihoodModel
from coded_aperture_ros.likelihood.bank import FilterBank

# Ranges that the network was trained for, px.
_WINDOWS_PX = (32, 72)
_STRIDES_PX = (4, 12)
_LARGEST_STEP_PX = 0.8
# Differences of sizes in steps of 0.8 px may be a little more.
_ROUNDING_PX = 1e-6
_LEAST_SPAN_PX = 3.0


@dataclasses.dataclass(frozen=True)
class DecoderChoice:
    """Decoder of the levels.

    Attributes
    ----------
    learned : bool
        Whether it is the network, else a classical regulariser.
    reason : str
        Why it is not the network, where that was asked for; else empty.
    """

    learned: bool
    reason: str = ""


def choose_decoder(model: LikelihoodModel, regularize: str, stride_px: int) -> DecoderChoice:
    """Decoder for a model: the network if `regularize` asks for it and it was trained for that.

    Parameters
    ----------
    model : LikelihoodModel
    regularize : str
        As in `DepthConfig`.
    stride_px : int
        Distance between patches.
    """
    if regularize != LEARNED:
        return DecoderChoice(learned=False)
    reason = unsupported_reason(model, stride_px)
    return DecoderChoice(not reason, reason)


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
