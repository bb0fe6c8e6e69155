"""How far every pixel of an all-in-focus frame can be relied on."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.deblur.blend.hypotheses import FARTHER, NEARER, hypothesis_blur_sizes

# What became of a pixel: no light of it was measured, or next to none, and it was made up from
# what is beside it; its depth is not known, or another surface is near; neither.
FILLED, UNCERTAIN, SEEN = range(3)
# Of the aperture, what has to see a pixel at least.
_LEAST_SEEN = 0.5
# By how much the blur of another surface beside differs, px. Levels without sizes are other
# surfaces in any case.
_OTHER_PX = 1.5
_OTHER_LEVEL = 0.5
# The error of a pixel is about so many times what deblurring has changed around it, to a power: of
# 71 random scenes behind three masks, noise 0.001 to 0.005, all methods but `inverse`. Half of the
# scenes set these numbers; of the others' pixels 70 % are within, of their worst scene's 44 %.
_OF_CHANGE = np.array([0.36, 0.29, 0.27], np.float32)  # by `FILLED` and so on
_POWER = 0.7
_AROUND_PX = 5
# What is left of the noise in any case: in standard deviations, and as a change.
_OF_NOISE = 1.5
_LEAST_CHANGE = 0.7


@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """Of the pixels of an all-in-focus frame; both [rows, columns]."""

    std_dev: FloatArray  # float32; of a channel's error, linear light
    kind: IndexArray  # `FILLED`, `UNCERTAIN` or `SEEN`


def classify_pixels(
    blur_size_px: FloatArray, known: BoolArray, seen: FloatArray, in_pixels: bool
) -> IndexArray:
    """Return what became of every pixel: `FILLED`, `UNCERTAIN` or `SEEN`.

    Maps [rows, columns] say how large the blur is, or which level it has, where that was measured,
    and how much of the aperture sees a pixel: 0 where the frame has no light of it, 1 where all
    does.
    """
    around = hypothesis_blur_sizes(blur_size_px)
    relief = around[FARTHER] - around[NEARER]
    kind = np.where(known & (relief <= (_OTHER_PX if in_pixels else _OTHER_LEVEL)), SEEN, UNCERTAIN)
    kind[seen < _LEAST_SEEN] = FILLED
    return kind


def estimate_uncertainty(
    frame: FloatArray, sharp: FloatArray, measured: BoolArray, kind: IndexArray, noise: float
) -> Uncertainty:
    """Return it for a frame and what deblurring has made of it, with `noise` in a channel."""
    if sharp.shape != frame.shape:
        shapes = f"expected {list(frame.shape)}, got {list(sharp.shape)}"
        raise InputError(f"all-in-focus frame: {shapes}")
    change = np.atleast_3d(sharp - frame)
    around = cv2.blur((change * change).mean(axis=2), (_AROUND_PX, _AROUND_PX))
    power = around + np.float32((_LEAST_CHANGE * noise) ** 2)
    variance = (_OF_CHANGE[kind] ** 2) * power**_POWER + np.float32((_OF_NOISE * noise) ** 2)
    # What was not measured was guessed from what is around: it may be anything that there is.
    contrast = np.var(frame[measured]) if measured.any() else np.inf
    variance[~measured] = np.maximum(variance[~measured], contrast)
    return Uncertainty(np.sqrt(variance), kind)
