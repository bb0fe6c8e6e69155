"""Two beliefs put together by NumPy, where there is no numba."""

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray

# Inverse depths are anywhere within this, 1/m: the density of those that are wrong is its inverse.
SPAN = 1.2
# Standard deviation below which two inverse depths are not told apart, 1/m.
FINEST = 0.004
# Difference of two inverse depths, as a share, within which one is as right as the other.
ALIKE = 0.06
MOST_CONFIDENCE = 0.9999
# Inverse depth, variance and confidence, float32 [pixels] each.
Maps = tuple[FloatArray, FloatArray, FloatArray]


def fuse_plain(past: Maps, present: Maps, agreement: float, found: Maps) -> None:
    """Form of `fuse` for NumPy."""
    (first, variance, sure), (second, other_variance, other) = past, present
    variances = variance + np.float32(FINEST**2), other_variance + np.float32(FINEST**2)
    together = variances[0] + variances[1]
    difference = np.square(first - second)
    odds = np.exp(-0.5 * difference / together) * (SPAN / np.sqrt(2 * np.pi * together))
    odds **= np.float32(agreement)
    both = sure * other * odds
    only_past, only_present = sure * (1 - other), other * (1 - sure)
    total = both + only_past + only_present + (1 - sure) * (1 - other)
    alike = np.square(ALIKE * np.maximum(first, second)) + np.float32(1e-12)
    alike = np.exp(-0.5 * difference / alike)
    agree = both >= np.maximum(only_past, only_present)
    takes_past = only_past >= only_present
    share = variances[1] / together
    inverse = np.where(
        agree, share * first + (1 - share) * second, np.where(takes_past, first, second)
    )
    spread = np.where(agree, share * variances[0], np.where(takes_past, *variances))
    confidence = np.where(
        agree, both + alike * (only_past + only_present), np.maximum(only_past, only_present)
    )
    confidence /= total
    most = np.maximum(np.float32(MOST_CONFIDENCE), np.maximum(sure, other))
    confidence = np.minimum(confidence, most)
    # Where one knows nothing the other stands as it is, to the last digit.
    for known, own in ((other, past), (sure, present)):
        for values, there in zip((inverse, spread, confidence), own, strict=True):
            np.copyto(values, there, where=known <= 0)
    for target, values in zip(found, (inverse, spread, confidence), strict=True):
        target[:] = values
