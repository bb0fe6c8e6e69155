"""What sharp images look like before blur: the natural-image power spectrum."""

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError

# Photographs in linear light, where one spectrum has to do for all patches: fall-off and contrast
# (variance).
_SLOPE = 2.4
_CONTRAST = 0.02
_SHARP_SLOPES = (1.6, 2.4, 3.2)


@dataclasses.dataclass(frozen=True)
class NaturalImagePrior:
    """Natural images as a Gaussian process with a power-law spectrum that lens and sensor soften.

    The power spectral density of a patch in focus is ``contrast / |frequency|**slope`` times what a
    small Gaussian blur leaves of it. Contrast, slope and softness differ from patch to patch, so
    none is fixed: the energies are minimised over a grid of contrasts and kinds of texture.

    Pictures have less power at the highest frequencies than a power law: lenses, demosaicing and
    resampling take it. Without soft kinds a narrow blur of such a texture looks like a wide one.

    Attributes
    ----------
    slopes : tuple of float
        Hypotheses for the fall-off of power with frequency, one for each kind of texture.
        Photographs scatter around 2.4; smooth shading is steeper, fine texture is flatter.
    contrasts : tuple of float
        Hypotheses for the variance of a sharp patch, linear light, in half decades.
    model_error : float
        What the PSF model leaves unexplained, as a fraction of the patch contrast (standard
        deviation). It keeps a bright, noise-free patch from trusting the model to the last digit.
    softness : tuple of float
        Standard deviation of the Gaussian, px, for each kind; empty: all are sharp.
    """

    slopes: tuple[float, ...] = (2.0, 2.0, 2.4, 2.4, 3.2)
    contrasts: tuple[float, ...] = tuple(10.0 ** (k / 2) for k in range(-10, -1))
    model_error: float = 3e-4
    softness: tuple[float, ...] = (0.0, 0.8, 0.5, 1.1, 0.0)

    def __post_init__(self) -> None:
        if not self.slopes or not all(0 < slope < 10 for slope in self.slopes):
            raise InputError(f"prior slopes: expected numbers in (0, 10), got {self.slopes}")
        if not self.contrasts or not all(contrast > 0 for contrast in self.contrasts):
            raise InputError(f"prior contrasts: expected positive numbers, got {self.contrasts}")
        if not 0 <= self.model_error < 1:
            raise InputError(f"prior model error: expected 0 to 1, got {self.model_error}")
        if self.softness and len(self.softness) != len(self.slopes):
            raise InputError(
                f"prior softness: expected one for each of {len(self.slopes)} slopes, "
                f"got {self.softness}"
            )
        if not all(0 <= softness < 10 for softness in self.softness):
            raise InputError(f"prior softness: expected numbers in [0, 10), got {self.softness}")

    @property
    def spectra(self) -> tuple[Callable[[tuple[int, int]], DoubleArray], ...]:
        """For each kind of texture, a function like `power_spectrum` of an image's shape."""
        softness = self.softness or (0.0,) * len(self.slopes)
        return tuple(
            partial(power_spectrum, slope, deviation=partial(_softening, width))
            for slope, width in zip(self.slopes, softness, strict=True)
        )

    def sharp(self) -> "NaturalImagePrior":
        """Return the prior without soft kinds: where softness would pass for short motion."""
        if not any(self.softness):
            return self
        return dataclasses.replace(self, slopes=_SHARP_SLOPES, softness=())


def _softening(width_px: float, scale: DoubleArray) -> DoubleArray:
    """Return what a Gaussian adds to the logarithm of the power, at logarithms of frequencies."""
    return -np.square(2 * np.pi * width_px * np.exp(scale))


def power_spectrum(
    slope: float,
    shape: tuple[int, int],
    deviation: Callable[[DoubleArray], DoubleArray] | None = None,
) -> DoubleArray:
    """Return the prior's power spectrum for unit contrast, laid out as by ``scipy.fft.rfft2``.

    Parameters
    ----------
    slope : float
        Exponent of the power law.
    shape : (int, int)
        Rows and columns of the image.
    deviation : callable, optional
        By how much the logarithm of the power departs from the power law, as a function of that
        of the frequency in cycles per pixel.

    Returns
    -------
    ndarray, float64 [rows, columns // 2 + 1]
        Power per frequency, scaled so that an image drawn from it has unit variance. The zero
        frequency gets the power of one cycle per image, because a power law has none there.
    """
    rows, columns = shape
    frequency = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns))
    frequency[0, 0] = 1 / max(shape)
    power = frequency**-slope
    if deviation is not None:
        power *= np.exp(deviation(np.log(frequency)))
    return power / np.mean(np.fft.irfft2(power, shape)[0, 0])


def image_prior(shape: tuple[int, int]) -> FloatArray:
    """Return the power spectrum of photographs of `shape`, as by ``scipy.fft.rfft2``."""
    return (_CONTRAST * power_spectrum(_SLOPE, shape)).astype(np.float32)
