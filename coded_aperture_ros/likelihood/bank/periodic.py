"""Texture of one band of frequencies, as of cloth, wood and blinds, which no power law describes.

It may look like usual texture at another depth. So it is tried beside that, at a few levels: what
it explains as well says nothing.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, IndexArray
from coded_aperture_ros.likelihood.bank.prior import power_spectrum

# About so many bands, the first and the last, cycles per pixel; how wide one is, in octaves, and
# by how much stronger than the power law that it stands on.
_BANDS, _FIRST, _LAST, _OCTAVES, _GAIN, _SLOPE = 6, 0.036, 0.22, 0.35, 50.0, 2.0
_EVERY, _FEWEST = 4, 3


def periodic_spectra(kinds: int) -> list[Callable[[tuple[int, int]], DoubleArray]]:
    """Return the power spectra of the bands, as functions of an image's shape.

    Several times as many as a bank has `kinds` of usual texture.
    """
    bands = np.geomspace(_FIRST, _LAST, kinds * max(1, round(_BANDS / kinds)))
    return [partial(power_spectrum, _SLOPE, deviation=partial(_band, band)) for band in bands]


def periodic_levels(levels: int) -> IndexArray:
    """Return at which of so many levels they are tried."""
    count = max(_FEWEST, -(-levels // _EVERY))
    return np.unique(np.round(np.linspace(0, levels - 1, count)).astype(np.intp))


def _band(frequency: float, logarithm: DoubleArray) -> DoubleArray:
    octaves = (logarithm - np.log(frequency)) / np.log(2)
    return np.asarray(np.log(_GAIN) * np.exp(-((octaves / _OCTAVES) ** 2) / 2))
