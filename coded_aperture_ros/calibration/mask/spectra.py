"""Expected spectra of masks for texture of natural shape, and derivatives by the masks.

A mixture of masks stands for one whose autocorrelation is the sum of theirs: no power spectrum can
tell the two apart. Grids of cells become PSFs, these one autocorrelation for every plane, and that
the expected power spectrum of a window. All steps but one are linear. What is measured are the
power spectra of the windows of pictures, and their means.
"""

import dataclasses

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.frames import channel_mean
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.likelihood.bank.prior import power_spectrum
from coded_aperture_ros.optics.psf import interpolated_shares, psf_width

SLOPES = (1.6, 2.4, 3.2)
_MODEL_ERROR = 3e-4
_STEP_PX = 5e-3
# Windows of little and of much contrast differ in how far they rise above the noise.
_CLASSES = 3


@dataclasses.dataclass(frozen=True, eq=False)
class Expected:
    """Expected power of masks at some blur sizes, and intermediate results for the derivatives.

    The power [slopes, I, K] is that of texture of unit contrast. Beside it: the masks [R, m, m],
    the blur sizes [I], the transforms of the PSFs [R, I, n, n // 2 + 1], padded so that their
    correlations do not wrap around, and the shares of cells in pixels [I, pixels, m].
    """

    power: NDArray
    parts: NDArray
    sizes_px: NDArray
    transforms: NDArray
    renderers: NDArray


class MaskSpectra:
    """Expected power spectra of a mixture of masks, and their derivatives.

    `counts` selects K frequencies; no blur size is larger than `widest_px`.
    """

    def __init__(self, fourier: WindowedFourierBasis, counts: BoolArray, widest_px: float) -> None:
        self.width = psf_width(widest_px)
        self.torus = (2 * self.width, 2 * self.width)
        self.lags = half_plane(self.width - 1)
        self.operators = np.array(
            [autocorrelation_to_power(fourier, slope, self.lags)[counts] for slope in SLOPES]
        )

    def expected(self, parts: NDArray, sizes_px: NDArray) -> Expected:
        """Expected power for every slope and blur size."""
        renderers = _renderers(self.width, parts.shape[-1], sizes_px)
        psfs = np.einsum("ipa,rab,iqb->ripq", renderers, parts, renderers, optimize=True)
        transforms = scipy.fft.rfft2(psfs, self.torus)
        correlations = scipy.fft.irfft2((np.abs(transforms) ** 2).sum(axis=0), self.torus)
        correlations = correlations[:, self.lags[:, 0], self.lags[:, 1]]
        power = np.array([correlations @ operator.T for operator in self.operators])
        power = np.maximum(power, 0) + _MODEL_ERROR**2
        return Expected(power, parts, sizes_px, transforms, renderers)

    def backward(self, by_power: NDArray, expected: Expected) -> tuple[NDArray, NDArray]:
        """Derivatives of a function by parts and sizes, from those by power."""
        # Slope by slope: einsum would copy the operators, which takes longer than the products.
        by_lag = np.zeros((by_power.shape[1], len(self.lags)))
        for slope_derivatives, operator in zip(by_power, self.operators, strict=True):
            by_lag += slope_derivatives @ operator / 2
        by_correlation = np.zeros((len(by_lag), *self.torus))
        by_correlation[:, self.lags[:, 0], self.lags[:, 1]] += by_lag
        by_correlation[:, -self.lags[:, 0], -self.lags[:, 1]] += by_lag
        by_psf = scipy.fft.irfft2(scipy.fft.rfft2(by_correlation) * expected.transforms, self.torus)
        by_psf = 2 * by_psf[..., : self.width, : self.width]
        parts = expected.parts
        renderers = expected.renderers
        by_parts = np.einsum("ipa,ripq,iqb->rab", renderers, by_psf, renderers, optimize=True)
        # The renderers are piecewise smooth in the size; a difference is as good as the derivative.
        above, below = (
            _renderers(self.width, parts.shape[-1], expected.sizes_px + step)
            for step in (_STEP_PX, -_STEP_PX)
        )
        slopes = (above - below) / (2 * _STEP_PX)
        along = "ripq,ipa,rab,iqb->i"
        by_sizes = np.einsum(along, by_psf, slopes, parts, renderers, optimize=True)
        by_sizes += np.einsum(along, by_psf, renderers, parts, slopes, optimize=True)
        return by_parts, by_sizes


def _renderers(pixels: int, cells: int, sizes_px: NDArray) -> NDArray:
    """Weights of pixels for the light of cells, one axis [I, pixels, cells]."""
    widths = np.maximum(sizes_px, 1e-3) / cells
    return np.array([interpolated_shares(pixels, cells, width, 0.0) for width in widths])


def half_plane(reach: int) -> IndexArray:
    """One of each pair of opposite lags up to `reach` [lags, 2]."""
    rows, columns = np.mgrid[-reach : reach + 1, : reach + 1]
    kept = (columns > 0) | (rows >= 0)
    return np.stack([rows[kept], columns[kept]], axis=1)


def autocorrelation_to_power(
    fourier: WindowedFourierBasis, slope: float, lags: IndexArray
) -> DoubleArray:
    """Matrix [K, lags] from a PSF's autocorrelation to a window's expected power.

    The same as `WindowedFourierBasis.expected_power`, written as a matrix.
    """
    n = fourier.window_px
    period = 4 * n
    torus = (period, period)
    covariance = scipy.fft.irfft2(power_spectrum(slope, torus), torus)
    window = scipy.fft.irfft(np.abs(scipy.fft.rfft(fourier.window, period)) ** 2, period)
    here = np.arange(-n, n)
    overlap = np.outer(window[here], window[here])
    columns = np.empty((fourier.size, len(lags)))
    for column, (row, across) in enumerate(lags):
        shifted = covariance[np.ix_((here - row) % period, (here - across) % period)]
        if row or across:  # and the opposite lag
            shifted = shifted + covariance[np.ix_((here + row) % period, (here + across) % period)]
        folded = (shifted * overlap).reshape(2, n, 2, n).sum(axis=(0, 2))
        columns[:, column] = scipy.fft.rfft2(folded).real.ravel()
    return columns


def window_powers(image: FloatArray, fourier: WindowedFourierBasis) -> FloatArray:
    """Power spectra of a picture's windows, a quarter of a window apart [W, K].

    White noise of variance s^2 has the power s^2. Raises `InputError` if the picture is smaller
    than a window.
    """
    power, _ = fourier.power(channel_mean(image), fourier.window_px // 4)
    return power.reshape(-1, fourier.size)


def mean_by_contrast(
    powers: NDArray[np.floating], fourier: WindowedFourierBasis, classes: int = _CLASSES
) -> FloatArray:
    """Mean spectra of windows [W, K] of about the same contrast [classes, K].

    Every window has the same weight, whatever its contrast: the mean itself would be that of a few
    strong edges. The means keep the scale of the noise; the least contrast comes first.
    """
    contrast = powers @ fourier.multiplicity
    members = np.array_split(np.argsort(contrast), min(classes, len(powers)))
    means = [
        (powers[chosen] / contrast[chosen, None]).mean(axis=0) / (1 / contrast[chosen]).mean()
        for chosen in members
    ]
    return np.array(means, np.float32)
