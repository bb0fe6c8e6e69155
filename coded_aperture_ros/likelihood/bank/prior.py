"""What sharp images look like before blur: the natural-image power spectrum."""

import dataclasses
from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, Shape
from coded_aperture_ros.core.errors import InputError

# Photographs in linear light, where one spectrum has to do for all patches: fall-off and contrast
# (variance).
_SLOPE = 2.4
_CONTRAST = 0.02


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
        What the PSF model leaves unexplained, as a fraction of the patch contrast (standard
        deviation). It keeps a bright, noise-free patch from trusting the model to the last digit.
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
    """Return the prior's power spectrum for unit contrast, laid out as by ``scipy.fft.rfft2``.

    For images of `shape` (rows, columns): float64 [rows, columns // 2 + 1], scaled so that an image
    drawn from it has unit variance. `slope` is the exponent of the power law, and `deviation` by
    how much the logarithm of the power departs from it, as a function of that of the frequency in
    cycles per pixel. The zero frequency gets the power of one cycle per image, because a power law
    has none there. Without a deviation the array is read-only.
    """
    rows, columns = shape
    if deviation is None:
        return _power_law(slope, rows, columns)
    frequency = _frequency(rows, columns)
    power = frequency**-slope * np.exp(deviation(np.log(frequency)))
    return power / np.mean(np.fft.irfft2(power, shape)[0, 0])


# Learning asks for the same few of them thousands of times.
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
    """Return the power spectrum of photographs of `shape`, as by ``scipy.fft.rfft2``."""
    return (_CONTRAST * power_spectrum(_SLOPE, shape)).astype(np.float32)
