"""Uncertainty of the pixels of an all-in-focus frame."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur.blend.hypotheses import FARTHER, NEARER, hypothesis_blur_sizes

# Kinds of pixels: filled from its neighbours, as (nearly) no light of it was measured; depth
# unknown, or another surface near; neither.
FILLED, UNCERTAIN, SEEN = range(3)
# Share of the aperture that has to see a pixel.
_MIN_VISIBLE_SHARE = 0.5
# By how much the blur of another surface beside differs, px. Levels without sizes are other
# surfaces in any case.
_OTHER_SURFACE_PX = 1.5
_OTHER_SURFACE_LEVELS = 0.5
# The error of a pixel is about so many times what deblurring has changed around it, to a power: of
# 71 random scenes behind three masks, noise 0.001 to 0.005, all methods but `inverse`. Half of the
# scenes set these numbers; of the others' pixels 70 % are within, of their worst scene's 44 %.
_ERROR_PER_CHANGE = np.array([0.36, 0.29, 0.27], np.float32)  # by `FILLED` and so on
_POWER = 0.7
_AROUND_PX = 5
# What is left of the noise in any case: in standard deviations, and as a change.
_NOISE_FACTOR = 1.5
_MIN_CHANGE = 0.7


@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of the pixels of an all-in-focus frame.

    Parameters
    ----------
    std_dev : ndarray, float32 [rows, columns]
        Standard deviation of a channel's error, linear light.
    kind : ndarray of int [rows, columns]
        `FILLED`, `UNCERTAIN` or `SEEN`.

    Examples
    --------
    See `Deblurrer.uncertainty`.
    """

    std_dev: FloatArray  # float32; of a channel's error, linear light
    kind: IndexArray  # `FILLED`, `UNCERTAIN` or `SEEN`


def classify_pixels(
    blur_size_px: FloatArray, known: BoolArray, seen: FloatArray, in_pixels: bool
) -> IndexArray:
    """Kind of each pixel [rows, columns]: `FILLED`, `UNCERTAIN` or `SEEN`.

    Parameters
    ----------
    blur_size_px : ndarray [rows, columns]
        Blur size or, if not `in_pixels`, level.
    known : ndarray of bool [rows, columns]
        Where it was measured.
    seen : ndarray [rows, columns]
        Share of the aperture that sees a pixel: 0 where the frame has no light of it.
    in_pixels : bool
    """
    around = hypothesis_blur_sizes(blur_size_px)
    relief = around[FARTHER] - around[NEARER]
    kind = np.where(
        known & (relief <= (_OTHER_SURFACE_PX if in_pixels else _OTHER_SURFACE_LEVELS)),
        SEEN,
        UNCERTAIN,
    )
    kind[seen < _MIN_VISIBLE_SHARE] = FILLED
    return kind


def estimate_uncertainty(
    frame: FloatArray, sharp: FloatArray, measured: BoolArray, kind: IndexArray, noise: float
) -> Uncertainty:
    """Uncertainty of a deblurred frame, for `noise` in a channel of the coded one."""
    if sharp.shape != frame.shape:
        shapes = f"expected {list(frame.shape)}, got {list(sharp.shape)}"
        raise InputError(f"all-in-focus frame: {shapes}")
    change = np.atleast_3d(sharp - frame)
    around = cv2.blur((change * change).mean(axis=2), (_AROUND_PX, _AROUND_PX))
    power = around + np.float32((_MIN_CHANGE * noise) ** 2)
    variance = (_ERROR_PER_CHANGE[kind] ** 2) * power**_POWER + np.float32(
        (_NOISE_FACTOR * noise) ** 2
    )
    # What was not measured was guessed from what is around: it may be anything that there is.
    contrast = np.var(frame[measured]) if measured.any() else np.inf
    variance[~measured] = np.maximum(variance[~measured], contrast)
    return Uncertainty(np.sqrt(variance), kind)
