"""Power spectra of windows, and what a PSF makes of natural texture in them."""

import dataclasses
from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
import scipy.fft

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.likelihood.bank.prior import power_spectrum

WINDOW_PX = 48
_HIGHEST_FREQUENCY = 0.5
# Coarser than in a bank: many PSFs are tried, and the same textures with all of them.
SLOPES = (2.0, 2.8)
_CONTRASTS = 10.0 ** np.arange(6)
_OWN_NOISE = 0.02
# Texture is rendered four windows wide; its spectrum is spread by the window's over so many bins.
_PERIOD, _REACH = 4 * WINDOW_PX, 10


@dataclasses.dataclass(frozen=True, eq=False)
class Frequencies:
    """The K frequencies of a window that count."""

    used: BoolArray  # [rows, columns]; which of ``scipy.fft.rfft2``
    vertical: DoubleArray  # [K]; cycles per pixel
    horizontal: DoubleArray
    share: FloatArray  # [K]; how much of a whole spectrum each stands for; the sum is 1
    window: FloatArray  # [N, N]; Hann window of unit energy

    @property
    def radius(self) -> DoubleArray:
        """Cycles per pixel in any direction [K]."""
        return np.asarray(np.hypot(self.vertical, self.horizontal))

    def directions(self, count: int) -> IndexArray:
        """Return which of `count` directions, of half a turn, each is nearest to [K]."""
        angle = np.arctan2(self.vertical, self.horizontal) % np.pi
        return (angle / np.pi * count + 0.5).astype(np.intp) % count


@lru_cache(maxsize=1)
def frequencies() -> Frequencies:
    """Return the frequencies that all spectra here have."""
    basis = WindowedFourierBasis(WINDOW_PX, _HIGHEST_FREQUENCY)
    n = WINDOW_PX
    multiplicity = basis.multiplicity.reshape(n, -1)
    used = multiplicity > 0
    vertical = np.broadcast_to(np.fft.fftfreq(n)[:, None], used.shape)[used]
    horizontal = np.broadcast_to(np.fft.rfftfreq(n), used.shape)[used]
    counts = multiplicity[used]
    window = np.outer(basis.window, basis.window)
    return Frequencies(used, vertical, horizontal, counts / counts.sum(), window)


def powers(windows: FloatArray) -> FloatArray:
    """Return the power [n, K] of windows [n, N, N], without their means."""
    at = frequencies()
    centred = windows - windows.mean(axis=(1, 2), keepdims=True)
    spectra = scipy.fft.rfft2(centred * at.window)[:, at.used]
    return np.asarray(spectra.real**2 + spectra.imag**2)


@dataclasses.dataclass(frozen=True, eq=False)
class Hypotheses:
    """What windows look like through each of P PSFs, with textures of each contrast and slope."""

    # [contrasts, P * slopes, K]; inverse of the expected power, in units of the noise, times the
    # frequencies' shares.
    weights: FloatArray
    log_determinants: FloatArray  # [contrasts, P * slopes]; mean logarithm of the expected power

    @classmethod
    def of(cls, psfs: Sequence[FloatArray]) -> "Hypotheses":
        """Compute them for P PSFs."""
        share = frequencies().share
        expected = np.concatenate([_expected_power(psf) for psf in psfs])
        power = _CONTRASTS[:, None, None] * expected + 1
        weights = (share / power).astype(np.float32)
        return cls(weights, (np.log(power) @ share).astype(np.float32))

    @classmethod
    def joined(cls, some: Sequence["Hypotheses"]) -> "Hypotheses":
        """Return those of all, one after the other."""
        weights = np.concatenate([each.weights for each in some], axis=1).swapaxes(1, 2)
        determinants = np.concatenate([each.log_determinants for each in some], axis=1)
        # Many are multiplied more quickly with frequencies first in memory.
        return cls(np.ascontiguousarray(weights).swapaxes(1, 2), determinants)

    def about(self, contrasts: IndexArray) -> "Hypotheses":
        """Return those of some contrasts and their neighbours."""
        some = slice(max(int(contrasts.min()) - 1, 0), int(contrasts.max()) + 2)
        return Hypotheses(self.weights[some], self.log_determinants[some])


def surprise(power: FloatArray, hypotheses: Hypotheses) -> FloatArray:
    """Return how badly each hypothesis explains windows [n, contrasts, P * slopes].

    Twice the negative log-likelihood per coefficient, but for a constant, with a noise of the
    window's own at its best value: the energy of `FilterBank`. `power` [n, K] is in units of the
    noise.
    """
    explained = power @ hypotheses.weights.swapaxes(1, 2)
    explained += np.float32(_OWN_NOISE)
    np.log(explained, out=explained)
    explained += hypotheses.log_determinants[:, None]
    return explained.swapaxes(0, 1)


def _expected_power(psf: FloatArray) -> DoubleArray:
    """Return the expected power of windows with texture of each slope [slopes, K].

    As `WindowedFourierBasis.expected_power` does, but the window's narrow spectrum is convolved
    with, which is a few times as fast and 0.2 % off.
    """
    kernel, margin = _window_spectrum(), _REACH + 2
    gain = np.abs(scipy.fft.rfft2(psf.astype(np.float64), (_PERIOD, _PERIOD))) ** 2
    found = []
    for texture in _textures():
        right = texture * gain
        # The left half of a spectrum is the right one turned around.
        turned = np.roll(right[::-1], 1, axis=0)
        whole = np.hstack([turned[:, margin:0:-1], right, turned[:, -2 : -margin - 2 : -1]])
        whole = np.vstack([whole[-margin:], whole, whole[:margin]])
        spread = cv2.sepFilter2D(whole, -1, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
        inner = spread[margin:-margin:4, margin : margin + _PERIOD // 2 + 1 : 4]
        found.append(np.maximum(inner[frequencies().used], 0))
    return np.array(found)


@lru_cache(maxsize=1)
def _textures() -> list[DoubleArray]:
    return [power_spectrum(slope, (_PERIOD, _PERIOD)) for slope in SLOPES]


@lru_cache(maxsize=1)
def _window_spectrum() -> DoubleArray:
    window = WindowedFourierBasis(WINDOW_PX).window.astype(np.float64)
    spectrum = np.abs(scipy.fft.fft(window, _PERIOD)) ** 2 / _PERIOD
    return np.roll(spectrum, _REACH)[: 2 * _REACH + 1]
