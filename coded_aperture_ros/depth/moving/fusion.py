"""Two beliefs of the same pixels, put together."""

import math

import numpy as np

from coded_aperture_ros.core.fast_math import CompiledMath, exponential, logarithm
from coded_aperture_ros.depth.moving.belief import Belief
from coded_aperture_ros.depth.moving.fusion_plain import (
    ALIKE,
    FINEST,
    MOST_CONFIDENCE,
    SPAN,
    Maps,
    fuse_plain,
)

_ONE, _HALF, _TINY = np.float32(1), np.float32(0.5), np.float32(1e-12)
_FINEST_VARIANCE, _ALIKE_VARIANCE = np.float32(FINEST**2), np.float32(ALIKE**2)
_MOST = np.float32(MOST_CONFIDENCE)
# Logarithm of the odds that two agree, but for their variances.
_SPAN_ODDS = np.float32(math.log(SPAN) - 0.5 * math.log(2 * math.pi))


def fused(past: Belief, present: Belief, agreement: float) -> Belief:
    """Belief of two that saw the same pixels.

    Either is right or somewhere else. Where both are right, which their difference tells, their
    Gaussians are multiplied; else the one that is likelier to be right stands.

    Parameters
    ----------
    past, present : Belief
    agreement : float
        How much it tells that both agree, in [0, 1]: 1 if their errors are independent.

    References
    ----------
    G. Vogiatzis and C. Hernandez, Video-based, real-time multi-view stereo, Image and Vision
    Computing 29, 2011 (Gaussian of what is right, uniform density of what is not).
    """
    found = np.empty((3, past.inverse.size), np.float32)
    fuse(
        tuple(values.ravel() for values in past.maps),
        tuple(values.ravel() for values in present.maps),
        np.float32(agreement),
        tuple(found),
    )
    return Belief(*found.reshape(3, *past.inverse.shape))


def _loop(past: Maps, present: Maps, agreement: np.float32, found: Maps) -> None:
    (first, first_variance, first_sure), (second, second_variance, second_sure) = past, present
    inverse, variance, confidence = found
    # Without branches, which keep it from vector instructions.
    for i in range(first.size):
        sure, other = first_sure[i], second_sure[i]
        own, others = first_variance[i] + _FINEST_VARIANCE, second_variance[i] + _FINEST_VARIANCE
        together = own + others
        difference = (first[i] - second[i]) ** 2
        only_first, only_second = sure * (_ONE - other), other * (_ONE - sure)
        likelier = max(only_first, only_second)
        exponent = _SPAN_ODDS - _HALF * (difference / together + logarithm(together))
        both = sure * other * exponential(agreement * exponent)
        tolerated = _ALIKE_VARIANCE * max(first[i], second[i]) ** 2 + _TINY
        alike = exponential(-_HALF * difference / tolerated)
        agree, takes_first = both >= likelier, only_first >= only_second
        share = others / together
        mean = share * first[i] + (_ONE - share) * second[i]
        value = mean if agree else (first[i] if takes_first else second[i])
        spread = share * own if agree else (own if takes_first else others)
        trust = both + alike * (only_first + only_second) if agree else likelier
        trust /= both + only_first + only_second + (_ONE - sure) * (_ONE - other)
        trust = min(trust, max(_MOST, max(sure, other)))
        # Where one knows nothing the other stands as it is, to the last digit.
        value, spread = (value, spread) if other > 0 else (first[i], first_variance[i])
        value, spread = (value, spread) if sure > 0 else (second[i], second_variance[i])
        inverse[i], variance[i] = value, spread
        confidence[i] = trust if sure > 0 and other > 0 else max(sure, other)


# Fills flat maps of what two beliefs tell together; see `fused`.
fuse = CompiledMath(_loop, fuse_plain)
