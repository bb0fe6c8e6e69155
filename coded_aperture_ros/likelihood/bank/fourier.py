"""Windowed Fourier basis: in it, the covariance of a blurred patch is nearly diagonal.

A patch is multiplied by a Hann window and transformed; blur is identified by the power of each
frequency. The transform is separable, and patches that
overlap share the horizontal half of it.
"""

import dataclasses
from collections.abc import Callable
from functools import cached_property

import numpy as np
import scipy.fft

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames.patches import PatchGrid
from coded_aperture_ros.likelihood.bank.prior import power_spectrum

# Blur has removed most of the texture above this frequency, cycles per pixel.
_HIGH_FREQUENCY = 0.42


@dataclasses.dataclass(frozen=True)
class WindowedFourierBasis:
    """Power spectra of Hann-windowed patches.

    A spectrum has K values: the frequencies of ``scipy.fft.rfft2`` in order.

    Examples
    --------
    >>> fourier = WindowedFourierBasis(32)
    >>> power, grid = fourier.power(np.zeros((48, 64), np.float32), stride_px=8)
    >>> power.shape, fourier.size
    ((3, 5, 544), 544)
    """

    window_px: int  # side of the square window; even
    # Frequencies above this, in cycles per pixel, do not count; by default all do.
    highest_frequency: float = 1.0

    def __post_init__(self) -> None:
        if self.window_px < 8 or self.window_px % 2:
            raise InputError(
                f"window: expected an even number of pixels, at least 8, got {self.window_px}"
            )

    @cached_property
    def window(self) -> FloatArray:
        """One side of the separable Hann window [window_px], with unit energy.

        With unit energy, white noise of variance s^2 has the expected power s^2 everywhere.
        """
        hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(self.window_px) / self.window_px)
        return (hann / np.linalg.norm(hann)).astype(np.float32)

    @cached_property
    def multiplicity(self) -> FloatArray:
        """Number of coefficients of the full transform at each frequency [K].

        0 for those that do not count: the mean of a patch does not depend on blur, and the Hann
        window spreads it over exactly the frequencies up to one cycle per window.
        """
        low_enough = self._frequency <= self.highest_frequency
        return (self._repetitions * low_enough).astype(np.float32)

    @cached_property
    def noise_weights(self) -> FloatArray:
        """Weights of the mean power of the highest frequencies [K]: blur leaves noise there."""
        weights = self._repetitions * (self._frequency > _HIGH_FREQUENCY)
        return (weights / weights.sum()).astype(np.float32)

    @property
    def _repetitions(self) -> IndexArray:
        vertical, horizontal = self._cycles
        once = (horizontal == 0) | (horizontal == self.window_px // 2)
        counts = np.maximum(vertical, horizontal) > 1
        return (np.where(once, 1, 2) * counts).ravel()

    @property
    def _frequency(self) -> DoubleArray:
        return np.hypot(*self._cycles).ravel() / self.window_px

    @property
    def _cycles(self) -> tuple[DoubleArray, DoubleArray]:
        n = self.window_px
        vertical = np.abs(np.fft.fftfreq(n) * n)[:, None]
        horizontal = np.fft.rfftfreq(n) * n
        shape = (n, len(horizontal))
        return np.broadcast_to(vertical, shape), np.broadcast_to(horizontal, shape)

    @property
    def size(self) -> int:
        """Number K of frequencies."""
        return self.window_px * (self.window_px // 2 + 1)

    def power(self, image: FloatArray, stride_px: int) -> tuple[FloatArray, PatchGrid]:
        """Power spectrum of every window, float32 [grid rows, grid columns, K], and their grid.

        It is slow: for learning and for tests.

        Parameters
        ----------
        image : ndarray, float32 [rows, columns]
            Without NaN.
        stride_px : int
            Distance between windows, px.

        Raises
        ------
        InputError
            If the image is smaller than the window.
        """
        n = self.window_px
        grid = PatchGrid.covering(image.shape, n, stride_px)
        windows = np.lib.stride_tricks.sliding_window_view(image[grid.top :, grid.left :], (n, n))
        power = np.empty((grid.rows, grid.columns, self.size), np.float32)
        hann = np.outer(self.window, self.window)
        for row_power, row in zip(power, windows[::stride_px, ::stride_px], strict=True):
            spectra = scipy.fft.rfft2(row * hann)
            row_power[:] = (spectra.real**2 + spectra.imag**2).reshape(grid.columns, -1)
        return power, grid

    def expected_power(
        self,
        psf: FloatArray,
        spectrum: float | Callable[[tuple[int, int]], DoubleArray],
        windows: int = 4,
    ) -> DoubleArray:
        """Expected power of a window on a textured, blurred plane, float64 [K].

        This is exact for the windowed transform: the autocovariance of the blurred texture is
        multiplied by the autocorrelation of the window before it is transformed. Sampling the
        blurred spectrum itself would ignore the leakage between frequencies.

        Parameters
        ----------
        psf : ndarray, float32 [k, k]
        spectrum : float or callable
            Exponent of the power law of the texture, see `NaturalImagePrior`, or a function of the
            shape of an image with the layout and scale of `power_spectrum`. The variance before
            the blur is 1.
        windows : int
            Period of the texture, in windows, 2 or more.
        """
        n = self.window_px
        # Wide enough: no wrap-around, and texture with room for lower frequencies.
        period = windows * max(n, *psf.shape)
        period += -period % n
        torus = (period, period)
        transfer = scipy.fft.rfft2(psf.astype(np.float64), torus)
        texture = spectrum(torus) if callable(spectrum) else power_spectrum(spectrum, torus)
        blurred = texture * np.abs(transfer) ** 2
        autocovariance = scipy.fft.irfft2(blurred, torus)
        overlap = scipy.fft.irfft(np.abs(scipy.fft.rfft(self.window, period)) ** 2, period)
        windowed = autocovariance * overlap[:, None] * overlap
        # The frequencies of a window are those of the period that its folded signal has.
        folded = windowed.reshape(period // n, n, period // n, n).sum(axis=(0, 2))
        return np.maximum(scipy.fft.rfft2(folded).real, 0).ravel()
