"""Relative blur sizes of planes, without knowing the mask.

The same mask shapes all spectra, stretched: twice the blur has its zeros at half the frequency. On
a logarithmic axis of frequency stretching is shifting, so that spectra are matched by correlation,
direction by direction, after what is smooth (texture) has been taken away.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
import scipy.fft
import scipy.ndimage
from numpy.typing import NDArray

from coded_aperture_ros.calibration.mask.spectra import mean_by_contrast, window_powers
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis

_DIRECTIONS = 48
# Of the logarithm of frequency.
_STEP = 0.02
# The lowest frequencies, in cycles per window, lie within the window's own width; the highest, in
# cycles per pixel, in the corners of the spectrum.
_MIN_CYCLES = 4
_MAX_FREQUENCY = 0.42
# Above this ratio of power to noise the shape of a spectrum is to be seen.
_MIN_SNR = 1.5
_SMOOTH_DEGREE = 2
# Blur sizes are looked for up to this ratio (9), in steps.
_MAX_SHIFT = round(2.2 / _STEP)
_ROUNDS = 5
_MIN_CORRELATION = 0.35
_MIN_RANGE = 1.15


@dataclasses.dataclass(frozen=True, eq=False)
class _Shape:
    """Deviation of a spectrum from smooth texture, with weights [directions, frequencies]."""

    deviation: DoubleArray
    weight: DoubleArray


def relative_blur_sizes(
    images: Sequence[FloatArray], names: Sequence[str], window_px: int
) -> DoubleArray:
    """Blur sizes of grey pictures but for a common factor [planes]; the largest is 1.

    They are good to some per cent. The window has to be four times as wide as the largest blur: the
    spectrum has to be resolved finely. Raises `InputError` if a spectrum has nothing in common with
    the others, or all are blurred alike.
    """
    shapes = [_shape(image, window_px) for image in images]
    count = len(shapes)
    gains = np.zeros((count, count, 2 * _MAX_SHIFT + 1))
    strongest = np.zeros((count, count))
    for i, j in itertools.permutations(range(count), 2):
        gains[i, j], strongest[i, j] = _shift_gains(shapes[i], shapes[j])
    for name, correlation in zip(names, strongest.max(axis=1), strict=True):
        if correlation < _MIN_CORRELATION:
            raise InputError(
                f"{name}: its spectrum has nothing in common with those of the other planes "
                f"(correlation {correlation:.2f}): blur there is too little or too much, or the "
                "mask has no pattern"
            )
    shifts = _consistent(gains)
    sizes = np.exp(_STEP * (shifts.min() - shifts))
    if sizes.min() * _MIN_RANGE > 1:
        raise InputError(
            "all planes are blurred alike, to "
            f"{1 / sizes.min() - 1:.0%}: mask and texture cannot be told apart; take planes at "
            "different distances, all on one side of the focus"
        )
    return np.asarray(sizes)


def _shape(image: FloatArray, window_px: int) -> _Shape:
    """Deviation of a spectrum from what is smooth, in polar coordinates."""
    fourier = WindowedFourierBasis(window_px)
    mean = mean_by_contrast(window_powers(image, fourier), fourier, classes=1)[0]
    mean = mean.astype(np.float64)
    noise = float(mean @ fourier.noise_weights)
    logarithm = np.arange(np.log(_MIN_CYCLES / window_px), np.log(_MAX_FREQUENCY), _STEP)
    angle = (np.arange(_DIRECTIONS) + 0.5) * np.pi / _DIRECTIONS
    # The half plane with positive horizontal frequencies; rows wrap around.
    half = mean.reshape(window_px, -1)
    radius = window_px * np.exp(logarithm)
    rows = radius * np.cos(angle)[:, None]
    columns = radius * np.sin(angle)[:, None]
    polar = scipy.ndimage.map_coordinates(
        np.log(np.roll(half, window_px // 2, axis=0)),
        [rows + window_px // 2, columns],
        order=1,
        mode="nearest",
    )
    ratio = np.exp(polar) / noise
    weight = np.where(ratio > _MIN_SNR, (1 - 1 / np.maximum(ratio, 1)) ** 2, 0)
    powers_of_frequency = np.vander(logarithm - logarithm.mean(), _SMOOTH_DEGREE + 1)
    deviation = np.empty_like(polar)
    for line, weights, out in zip(polar, np.sqrt(weight + 1e-6), deviation, strict=True):
        terms = weights[:, None] * powers_of_frequency
        smooth, *_ = np.linalg.lstsq(terms, weights * line, rcond=None)
        out[:] = line - powers_of_frequency @ smooth
    return _Shape(deviation, weight)


def _shift_gains(first: _Shape, second: _Shape) -> tuple[NDArray, float]:
    """Log-likelihood gain of every shift between two spectra, and the best correlation."""
    period = 2 * first.weight.shape[1] + 2 * _MAX_SHIFT

    def correlated(a: NDArray, b: NDArray) -> DoubleArray:
        spectrum = np.conj(scipy.fft.rfft(a, period)) * scipy.fft.rfft(b, period)
        both = scipy.fft.irfft(spectrum.sum(axis=0), period)
        return np.asarray(both[np.arange(-_MAX_SHIFT, _MAX_SHIFT + 1)])

    a = first.deviation
    v = first.weight
    b = second.deviation
    w = second.weight
    common = np.maximum(correlated(v, w), 0)
    scale = np.sqrt(np.maximum(correlated(v * a**2, w) * correlated(v, w * b**2), 1e-9))
    correlation = np.clip(correlated(v * a, w * b) / scale, 0, 0.99)
    gain = -common * np.log(1 - correlation**2)
    return gain, float(correlation[gain.argmax()])


def _consistent(gains: NDArray) -> NDArray:
    """Shift of every spectrum under which all pairs together gain most [planes]."""
    count = len(gains)
    places = np.arange(-2 * _MAX_SHIFT, 2 * _MAX_SHIFT + 1)

    def gain_of(j: int, others: dict[int, int]) -> DoubleArray:
        total = np.zeros(len(places))
        for i, place in others.items():
            apart = places - place
            near = np.abs(apart) <= _MAX_SHIFT
            total[near] += gains[i, j, apart[near] + _MAX_SHIFT]
        return total

    best = gains.max(axis=2)
    found = {int(np.unravel_index(best.argmax(), best.shape)[0]): 0}
    while len(found) < count:  # the surest first
        _, j = max((best[i, j], j) for i in found for j in range(count) if j not in found)
        found[j] = int(places[gain_of(j, found).argmax()])
    for _ in range(_ROUNDS):
        for j in range(count):
            others = {i: place for i, place in found.items() if i != j}
            found[j] = int(places[gain_of(j, others).argmax()])
    return np.array([found[i] for i in range(count)], float)
