"""Likelihood ratio of a bank's PSFs against other optics, beside what fitting frames show.

The networks of the check know the kinds of misfit that they learned from. This test knows none: the
PSFs of the bank explain a fitting frame better than other optics do, by as much as their spectra
say. Texture with directions is allowed for, as text and buildings have it. How far frames of real
texture are from that is measured with simulated frames, for each mask.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.fft

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, in_memory
from coded_aperture_ros.depth.quality.evidence import (
    FEWEST_WINDOWS,
    HypothesisTest,
    cut_windows,
    texture_and_weight,
    windows_of_cells,
)
from coded_aperture_ros.depth.quality.mask_test import middle_part
from coded_aperture_ros.depth.quality.spectra import (
    NAMES,
    OWN_NOISE,
    PERIOD,
    SLOPES,
    PsfHypotheses,
    frequencies,
    negative_log_likelihood,
    power_spectra,
    window_power,
)
from coded_aperture_ros.likelihood.bank.prior import power_spectrum

# Spectral slopes of texture without directions, and of texture that is stretched.
_SLOPES = (1.6, 2.4, 3.2)
_SLOPE = 2.4
_STRETCH, _STRETCHED = 2.5, 4
_CROSSED_STRETCH = 4.0
# Band in which all textures have the same mean power, cycles/px.
_BAND = (0.05, 0.3)
# Filters behind the sensor: Gaussian, sigma in px; enlarged linearly and with a cubic, factor.
_GAUSSIAN_PX = (0.5, 0.7, 1.0, 1.5)
_LINEAR = (1.2, 1.5, 2.0)
_CUBIC = (1.2, 1.5)
_CUBIC_SHARPNESS = -0.75
# Most windows along a side of a frame.
_CELLS = 5
# Filters are tried with so many levels of the bank.
_FILTERED_LEVELS = 7
# Gains of single windows count up to this, hundredths of the negative log-likelihood.
_MOST_GAIN = 6.0
# The mean of so many of the largest surprises counts.
_LARGEST = 5
# What is added to the deviation of the gains of simulated frames, hundredths: real texture differs.
_DEVIATION = 0.2
# How the logit of health falls with the surprise, from the surprise of fitting frames on, both in
# units of their limit, and the most that it falls: what the networks are surer of fits.
_SLOPE_OF_HEALTH = 4.0
_EXPECTED = 1.0
_MOST_LOWERED = 3.0
# From this logit on nothing changes, as health stays above 0.7: half of the fitting frames.
_SURE = _MOST_LOWERED + 0.85
# Noise that a filtered frame has beside what has passed the filter, as rounding leaves it; share of
# its power.
_UNFILTERED = 0.01


class OpticsTest:
    """Likelihood-ratio test of a bank's PSFs against other optics.

    Parameters
    ----------
    test : HypothesisTest
        Of the bank.
    """

    def __init__(self, test: HypothesisTest) -> None:
        self._hypotheses, psfs = test, test.levels.psfs
        own = _hypotheses(psfs, _textures())
        some = psfs[:: max(len(psfs) // _FILTERED_LEVELS, 1)]
        plain = [power_spectrum(slope, (PERIOD, PERIOD)) for slope in SLOPES]
        each = [_hypotheses(some, plain, response) for response in _responses()]
        self._own, self._filtered = own, PsfHypotheses.concatenate(each)
        self._filters = len(each)
        self._expected = self._gains_of_expected()

    def gains(
        self, grey: FloatArray, noise: float, unusable: BoolArray | None
    ) -> DoubleArray | None:
        """By how much other optics explain the windows better than is expected of frames that fit.

        Hundredths of the negative log-likelihood per coefficient, mean over the windows, one for
        each of `NAMES` and of the filters; NaN where the bank has no such alternative. None if too
        few windows have texture. Parameters are those of `HypothesisTest.score`.
        """
        tops, lefts, _ = windows_of_cells(grey, unusable, _CELLS)
        if len(tops) < FEWEST_WINDOWS:
            return None
        power = power_spectra(cut_windows(grey, tops, lefts)) / np.float32(noise**2)
        scores = negative_log_likelihood(power, self._own)
        flat = scores.reshape(len(power), -1)
        best = flat.argmin(axis=1)
        contrast = best // scores.shape[2]
        # Contrasts near those that explain the windows are enough.
        others, filtered = (
            each.near_contrasts(contrast.min(), contrast.max())
            for each in (self._hypotheses.others, self._filtered)
        )
        found = np.hstack([self._alternatives(power, others), self._least(power, filtered)])
        gain = _limited(flat[np.arange(len(power)), best][:, None] - found)
        _, weight = texture_and_weight(power)
        return np.asarray(weight @ (gain - self._expected[best]) / weight.sum())

    def _alternatives(self, power: FloatArray, others: PsfHypotheses) -> FloatArray:
        """Least negative log-likelihood of each of `NAMES`; NaN where the bank has none."""
        missing = np.full(len(power), np.nan, np.float32)
        each = negative_log_likelihood(power, others).min(axis=1)
        groups = self._hypotheses.groups
        tried = {name: each[:, group].min(axis=1) for name, group in groups.items()}
        return np.stack([tried.get(name, missing) for name in NAMES], axis=-1)

    def _least(self, power: FloatArray, filtered: PsfHypotheses) -> FloatArray:
        each = negative_log_likelihood(power, filtered).min(axis=1)
        return np.asarray(each.reshape(len(power), self._filters, -1).min(axis=2))

    def _gains_of_expected(self) -> FloatArray:
        """Gains [own hypotheses, alternatives] where a window is as the hypothesis expects it."""
        power = frequencies().share / self._own.weights.reshape(-1, self._own.weights.shape[-1])
        least = self._own.log_determinants.reshape(-1) + np.log1p(OWN_NOISE)
        others = self._alternatives(power, self._hypotheses.others)
        found = np.hstack([others, self._least(power, self._filtered)])
        return _limited(least[:, None] - found)


class OpticsFit:
    """Outputs of the check's networks, less health where other optics explain a frame too well.

    Parameters
    ----------
    limits : tuple of float
        See `fitted_limits`.
    middle_only : bool
        Whether only windows in the middle of the frame count; see `FitCheck`.
    """

    def __init__(self, limits: tuple[float, ...], middle_only: bool = False) -> None:
        self._limits, self._middle_only = limits, middle_only
        self._test: OpticsTest | None = None

    def __call__(
        self, outputs: FloatArray, test: HypothesisTest, given: Mapping[str, Any]
    ) -> FloatArray:
        """Logits of health, then of the causes; see `outputs_of`.

        Parameters
        ----------
        outputs : ndarray, float32 [n]
            Of the networks.
        test : HypothesisTest
        given : mapping
            `grey`, `noise` and `unusable` of `HypothesisTest.score`; of NumPy or on a device.
        """
        if not 0 <= outputs[0] < _SURE:
            return outputs
        self._test = self._test or OpticsTest(test)
        grey, noise, unusable = (given[name] for name in ("grey", "noise", "unusable"))
        part = middle_part(grey.shape) if self._middle_only else np.s_[0:, 0:]
        inner = None if unusable is None else in_memory(unusable[part])
        gains = self._test.gains(in_memory(grey[part]), noise, inner)
        if gains is None:
            return outputs
        above = surprise(gains, self._limits)
        lowered = outputs.copy()
        lowered[0] -= np.clip(_SLOPE_OF_HEALTH * (above - _EXPECTED), 0, _MOST_LOWERED)
        return lowered


def surprise(gains: DoubleArray, limits: tuple[float, ...]) -> float:
    """Mean of the largest surprises of the gains, in units of the limit of fitting frames.

    Parameters
    ----------
    gains : ndarray [k]
        See `OpticsTest.gains`.
    limits : tuple of float
        Mean of each in fitting frames, then the deviations, and the limit; see `fitted_limits`.
    """
    mean, deviation = np.reshape(limits[:-1], (2, -1))
    surprises = np.nan_to_num((gains - mean) / deviation)
    return float(np.sort(surprises)[-_LARGEST:].mean()) / limits[-1]


def fitted_limits(gains: DoubleArray, share: float) -> tuple[float, ...]:
    """Limits of the gains [frames, k] of fitting frames, all but a share of which are below 1."""
    missing = np.isnan(gains).all(axis=0)
    mean = np.where(missing, 0.0, np.nan_to_num(gains).mean(axis=0))
    deviation = np.nan_to_num(gains).std(axis=0) + _DEVIATION
    plain = (*mean.tolist(), *deviation.tolist(), 1.0)
    return (*plain[:-1], float(np.quantile([surprise(each, plain) for each in gains], 1 - share)))


def _hypotheses(
    psfs: Sequence[FloatArray], textures: Sequence[DoubleArray], response: DoubleArray | None = None
) -> PsfHypotheses:
    """Hypotheses of P PSFs and T textures, perhaps with a filter that the noise passes, too."""
    passed = 1.0 if response is None else response
    powers = [
        window_power(texture * np.abs(scipy.fft.rfft2(psf, (PERIOD, PERIOD))) ** 2 * passed)
        for psf in psfs
        for texture in textures
    ]
    noise = 1.0 if response is None else window_power(response) + _UNFILTERED
    return PsfHypotheses.from_power(np.array(powers), noise)


def _limited(gain: FloatArray) -> FloatArray:
    return np.clip(100 * gain, -_MOST_GAIN, _MOST_GAIN)


def _frequencies() -> tuple[DoubleArray, DoubleArray]:
    vertical, horizontal = np.fft.fftfreq(PERIOD), np.fft.rfftfreq(PERIOD)
    return vertical[:, None].astype(np.float64), horizontal.astype(np.float64)


@lru_cache(maxsize=1)
def _textures() -> tuple[DoubleArray, ...]:
    """Power spectra of textures: of several slopes, stretched, and of two directions."""
    shape = (PERIOD, PERIOD)
    turns = np.pi * np.arange(_STRETCHED) / _STRETCHED
    stretched = [_stretched(turn, _STRETCH) for turn in turns]
    crossed = [
        _stretched(turn, _CROSSED_STRETCH) + _stretched(turn + np.pi / 2, _CROSSED_STRETCH)
        for turn in (0.0, np.pi / 4)
    ]
    return (*(power_spectrum(slope, shape) for slope in _SLOPES), *stretched, *crossed)


def _stretched(turn: float, stretch: float) -> DoubleArray:
    vertical, horizontal = _frequencies()
    along = np.cos(turn) * horizontal + np.sin(turn) * vertical
    across = np.cos(turn) * vertical - np.sin(turn) * horizontal
    radius = np.hypot(along * np.sqrt(stretch), across / np.sqrt(stretch))
    radius[0, 0] = np.inf
    power = radius**-_SLOPE
    distance = np.hypot(vertical, horizontal)
    band = (distance > _BAND[0]) & (distance < _BAND[1])
    return power * (power_spectrum(_SLOPE, (PERIOD, PERIOD))[band].mean() / power[band].mean())


def _responses() -> list[DoubleArray]:
    """Squared responses of filters behind the sensor."""
    vertical, horizontal = _frequencies()
    square = vertical**2 + horizontal**2
    blurs = [np.exp(-((2 * np.pi * sigma_px) ** 2) * square) for sigma_px in _GAUSSIAN_PX]
    linear = [(np.sinc(vertical * n) * np.sinc(horizontal * n)) ** 4 for n in _LINEAR]
    cubic = [(_cubic(vertical * n) * _cubic(horizontal * n)) ** 2 for n in _CUBIC]
    return [*blurs, *linear, *cubic]


def _cubic(frequency: DoubleArray) -> DoubleArray:
    """Response of cubic interpolation at some frequencies, in cycles per source pixel."""
    place = np.linspace(0, 2, 401)
    a = _CUBIC_SHARPNESS
    inner = (a + 2) * place**3 - (a + 3) * place**2 + 1
    outer = a * (place**3 - 5 * place**2 + 8 * place - 4)
    kernel = np.where(place <= 1, inner, outer)
    kernel[[0, -1]] /= 2
    return np.asarray(np.cos(2 * np.pi * frequency[..., None] * place) @ kernel * 2 * place[1])
