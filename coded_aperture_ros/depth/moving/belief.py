"""What is believed of every pixel's depth, carried to another view and put together."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.depth.moving.geometry import Pinhole, Transfer

# Inverse depths are anywhere within this, 1/m: the density of those that are wrong is its inverse.
_SPAN = 1.2
# Standard deviation below which two inverse depths are not told apart, 1/m.
_FINEST = 0.004
# Difference of two inverse depths, as a share, within which one is as right as the other.
_ALIKE = 0.06
# Variance that a step adds, as a share of the squared inverse depth: pixels are whole.
_STEP_VARIANCE = 1e-4
# Brightness that may differ between two frames of the same point, as a share, and the darkness
# below which shares mean nothing, linear light.
_LIGHT_SHARE, _DARK = 0.15, 0.02
# Of so many places one is enough for a median.
_SPARSE = 8
# What is nearer hides what is farther if it is at least so sure, as a share of the surest there.
_HIDES = 0.7
_LEAST_CONFIDENCE = 0.02
_MOST_CONFIDENCE = 0.9999
# Cracks between pixels that were carried apart are filled from around them, so surely.
_CRACK_SHARE = 0.5


# Log-odds of a confidence that frames have agreed on, and those of being within 5 %, on walks
# through five rooms made by chance: frames have more errors in common than is reckoned with.
_BELIEVED = (-9.0, -3.0, -1.3, -0.7, 0.0, 0.5, 1.6, 2.5, 3.25, 4.25, 5.5, 6.5, 7.5, 8.5)
_RIGHT = (-9.0, -3.5, -1.0, -0.9, 0.48, 0.6, 0.67, 1.0, 1.38, 2.08, 2.82, 3.4, 4.4, 5.5)


@dataclasses.dataclass(frozen=True, eq=False)
class Belief:
    """Gaussian of every pixel's inverse depth, and how likely it is about right.

    Attributes
    ----------
    inverse : ndarray, float32 [rows, columns]
        Inverse depth, 1/m; 0 at infinity.
    variance : ndarray, float32 [rows, columns]
        Of the inverse depth, where it is right.
    confidence : ndarray, float32 [rows, columns]
        Probability, in [0, 1], that it is; 0: nothing is known.
    """

    inverse: FloatArray
    variance: FloatArray
    confidence: FloatArray

    @property
    def published_confidence(self) -> FloatArray:
        """Measured probability of an error of at most 5 %, in [0, 1], float32 [rows, columns]."""
        limited = np.clip(self.confidence, 1e-4, _MOST_CONFIDENCE)
        odds = np.interp(np.log(limited / (1 - limited)), _BELIEVED, _RIGHT)
        return (1 / (1 + np.exp(-odds))).astype(np.float32)


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
    first, second = past.inverse, present.inverse
    variances = past.variance + _FINEST**2, present.variance + _FINEST**2
    together = variances[0] + variances[1]
    difference = np.square(first - second)
    odds = np.exp(-0.5 * difference / together) * (_SPAN / np.sqrt(2 * np.pi * together))
    odds **= np.float32(agreement)
    sure, other = past.confidence, present.confidence
    both = sure * other * odds
    only_past, only_present = sure * (1 - other), other * (1 - sure)
    total = both + only_past + only_present + (1 - sure) * (1 - other)
    alike = np.exp(
        -0.5 * difference / (np.square(_ALIKE * np.maximum(first, second)) + np.float32(1e-12))
    )
    agree = both >= np.maximum(only_past, only_present)
    takes_past = only_past >= only_present
    share = variances[1] / together
    inverse = np.where(
        agree, share * first + (1 - share) * second, np.where(takes_past, first, second)
    )
    variance = np.where(agree, share * variances[0], np.where(takes_past, *variances))
    confidence = np.where(
        agree, both + alike * (only_past + only_present), np.maximum(only_past, only_present)
    )
    confidence /= total
    # Where one knows nothing the other stands as it is, to the last digit.
    for known, own in ((other, past), (sure, present)):
        alone = known <= 0
        np.copyto(inverse, own.inverse, where=alone)
        np.copyto(variance, own.variance, where=alone)
        np.copyto(confidence, own.confidence, where=alone)
    most = np.maximum(_MOST_CONFIDENCE, np.maximum(sure, other))
    return Belief(inverse, variance, np.minimum(confidence, most))


def carried(
    belief: Belief,
    light: FloatArray,
    now: FloatArray,
    view: Pinhole,
    motion: DoubleArray,
    keep: float,
) -> Belief:
    """Belief of a past frame as the present one sees it; confidence 0 where nothing of it is.

    Parameters
    ----------
    belief : Belief
    light, now : ndarray, float32 [rows, columns]
        Smoothed brightness of the past frame and of the present one, linear light. Where it
        differs by more than the exposure, something else has come before it.
    view : Pinhole
        Of both frames.
    motion : ndarray, float64 [4, 4]
        Turns points of the past view into those of the present one.
    keep : float
        Confidence that is left of one, in [0, 1].
    """
    transfer = Transfer(view, motion)
    rows, columns = view.shape
    column, row = (np.rint(at).astype(np.int32) for at in transfer.columns_rows(belief.inverse))
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    inside &= transfer.is_ahead(belief.inverse) & (belief.confidence > _LEAST_CONFIDENCE)
    target = (row * columns + column)[inside]
    nearer = 1 / transfer.depth_ratio(belief.inverse)[inside]
    inverse = belief.inverse[inside]
    variance = (belief.variance[inside] + _STEP_VARIANCE * np.square(inverse)) * np.square(nearer)
    inverse = np.asarray(inverse * nearer, np.float32)
    seen, was = now.ravel()[target], light[inside]
    differs = (was * exposure_ratio(seen, was) - seen) / (_LIGHT_SHARE * (seen + _DARK))
    confidence = np.float32(keep) * belief.confidence[inside] * np.exp(-0.5 * np.square(differs))
    surest = np.zeros(rows * columns, np.float32)
    np.maximum.at(surest, target, confidence)
    stands = confidence >= np.maximum(_HIDES * surest[target], _LEAST_CONFIDENCE)
    target, inverse, variance, confidence = (
        values[stands] for values in (target, inverse, variance, confidence)
    )
    nearest = np.full(rows * columns, -1, np.float32)
    np.maximum.at(nearest, target, inverse)
    first = inverse == nearest[target]
    maps = np.zeros((3, rows * columns), np.float32)
    for values, there in zip(maps, (inverse, variance, confidence), strict=True):
        values[target[first]] = there[first]
    return _without_cracks(Belief(*maps.reshape(3, rows, columns)))


def exposure_ratio(now: FloatArray, then: FloatArray) -> np.float32:
    """By how much a frame is brighter than another, by the median of the same places.

    1 where there are none. Cameras change their exposure by themselves.
    """
    some_now, some_then = now[..., ::_SPARSE], then[..., ::_SPARSE]
    lit = some_then > _DARK * _DARK
    return np.float32(np.median(some_now[lit] / some_then[lit])) if lit.any() else np.float32(1)


def _without_cracks(belief: Belief) -> Belief:
    """Belief with single empty pixels filled by the mean around them."""
    empty = belief.confidence == 0
    known = (~empty).astype(np.float32)
    share = np.maximum(cv2.blur(known, (3, 3)), np.float32(1e-6))
    inverse, variance, confidence = (
        np.where(empty, cv2.blur(values, (3, 3)) / share, values)
        for values in (belief.inverse, belief.variance, belief.confidence)
    )
    confidence[empty] *= _CRACK_SHARE
    return Belief(inverse, variance, confidence)
