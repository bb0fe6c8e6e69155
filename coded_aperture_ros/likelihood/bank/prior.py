"""Power spectra of sharp images: natural texture, and periodic texture."""

import dataclasses
from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray, Shape
from coded_aperture_ros.core.errors import InputError

# Photographs in linear light, where one spectrum has to do for all patches: exponent of the power
# law, and contrast (variance).
_PHOTO_SLOPE = 2.4
_PHOTO_CONTRAST = 0.02

# Periodic texture, as of cloth, wood and blinds, has one band of frequencies, which no power law
# describes, and may look like usual texture at another depth. It is compared with usual texture at
# a few levels: what it explains as well says nothing about depth.
# Number of bands, about; the first and the last, cycles per pixel.
_BAND_COUNT = 6
_FIRST_BAND = 0.036
_LAST_BAND = 0.22
# Width of a band, octaves (standard deviation); its power over that of the power law below it, and
# the exponent of that power law.
_BAND_OCTAVES = 0.35
_BAND_GAIN = 50.0
_BAND_SLOPE = 2.0
# Every so many levels have periodic texture, but no fewer than this.
_PERIODIC_LEVEL_STEP = 4
_MIN_PERIODIC_LEVELS = 3


@dataclasses.dataclass(frozen=True)
class NaturalImagePrior:
    """Natural images as a Gaussian process with a power-law spectrum.

    The power spectral density of a sharp patch is ``contrast / |frequency|**slope``. Both the
    contrast and the slope differ from patch to patch, so neither is fixed: the energies are
    minimised over a grid of both.

    Attributes
    ----------
    slopes : tuple of float
        Hypotheses for the fall-off of power with frequency. Photographs scatter around 2.4;
        smooth shading is steeper, fine texture is flatter.
    contrasts : tuple of float
        Hypotheses for the variance of a sharp patch, linear light, in half decades.
    model_error : float
        Error of the PSF model, as a fraction of the patch contrast (standard deviation). It
        limits the confidence in the model for bright patches without noise.

    Examples
    --------
    >>> [spectrum((8, 8)).shape for spectrum in NaturalImagePrior().spectra]
    [(8, 5), (8, 5), (8, 5)]
    """

    slopes: tuple[float, ...] = (1.6, 2.4, 3.2)
    contrasts: tuple[float, ...] = tuple(10.0 ** (k / 2) for k in range(-10, -1))
    model_error: float = 3e-4

    def __post_init__(self) -> None:
        if not self.slopes or not all(0 < slope < 10 for slope in self.slopes):
            raise InputError(f"prior slopes: expected numbers in (0, 10), got {self.slopes}")
        if not self.contrasts or not all(contrast > 0 for contrast in self.contrasts):
            raise InputError(f"prior contrasts: expected positive numbers, got {self.contrasts}")
        if not 0 <= self.model_error < 1:
            raise InputError(f"prior model error: expected 0 to 1, got {self.model_error}")

    @property
    def spectra(self) -> tuple[Callable[[tuple[int, int]], DoubleArray], ...]:
        """For each slope, `power_spectrum` as a function of an image's shape."""
        return tuple(partial(power_spectrum, slope) for slope in self.slopes)


def power_spectrum(
    slope: float, shape: Shape, deviation: Callable[[DoubleArray], DoubleArray] | None = None
) -> DoubleArray:
    """Power spectrum of texture of unit variance, laid out as by ``scipy.fft.rfft2``.

    The zero frequency has the power of one cycle per image, because a power law has none there.

    Parameters
    ----------
    slope : float
        Exponent of the power law; 0: white.
    shape : (int, int)
        Rows and columns of the image.
    deviation : callable, optional
        Difference of the logarithm of the power from that of the power law, as a function of the
        logarithm of the frequency in cycles per pixel.

    Returns
    -------
    ndarray, float64 [rows, columns // 2 + 1]
        Read-only without a deviation.

    Examples
    --------
    >>> power_spectrum(2.0, (4, 4)).shape
    (4, 3)
    """
    rows, columns = shape
    if deviation is None:
        return _power_law(slope, rows, columns)
    frequency = _frequency(rows, columns)
    power = frequency**-slope * np.exp(deviation(np.log(frequency)))
    return power / np.mean(np.fft.irfft2(power, shape)[0, 0])


# Learning needs the same few spectra thousands of times.
@lru_cache(maxsize=16)
def _power_law(slope: float, rows: int, columns: int) -> DoubleArray:
    power = _frequency(rows, columns) ** -slope
    power /= np.mean(np.fft.irfft2(power, (rows, columns))[0, 0])
    power.flags.writeable = False
    return power


def _frequency(rows: int, columns: int) -> DoubleArray:
    """Cycles per pixel, with one cycle per image in place of zero."""
    frequency = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns))
    frequency[0, 0] = 1 / max(rows, columns)
    return frequency


def image_prior(shape: Shape) -> FloatArray:
    """Power spectrum of photographs of a shape, float32, laid out as by ``scipy.fft.rfft2``.

    Examples
    --------
    >>> image_prior((4, 4)).shape
    (4, 3)
    """
    return (_PHOTO_CONTRAST * power_spectrum(_PHOTO_SLOPE, shape)).astype(np.float32)


def periodic_spectra(kinds: int) -> list[Callable[[tuple[int, int]], DoubleArray]]:
    """Power spectra of periodic texture, as functions of an image's shape (rows, columns).

    Their number is the multiple of `kinds`, a bank's kinds of usual texture, nearest to six.
    """
    bands = np.geomspace(_FIRST_BAND, _LAST_BAND, kinds * max(1, round(_BAND_COUNT / kinds)))
    return [
        partial(power_spectrum, _BAND_SLOPE, deviation=partial(_band_log_gain, band))
        for band in bands
    ]


def periodic_levels(levels: int) -> IndexArray:
    """Indices of those of L levels that are compared with periodic texture [n]."""
    count = max(_MIN_PERIODIC_LEVELS, -(-levels // _PERIODIC_LEVEL_STEP))
    return np.unique(np.round(np.linspace(0, levels - 1, count)).astype(np.intp))


def _band_log_gain(frequency: float, logarithm: DoubleArray) -> DoubleArray:
    """Logarithm of a band's gain at the logarithms of frequencies."""
    octaves = (logarithm - np.log(frequency)) / np.log(2)
    return np.asarray(np.log(_BAND_GAIN) * np.exp(-((octaves / _BAND_OCTAVES) ** 2) / 2))
