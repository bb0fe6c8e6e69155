"""Sensor noise from frames of a static scene: the photon transfer method.

The difference of two frames of the same scene has no texture, only the noise of both. Its variance
grows with the light: a line whose offset is the read-out noise, and whose slope is the shot noise
per unit of light.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize

from coded_aperture_ros.core.errors import InputError

_BINS = 48
_MIN_PIXELS = 2_000
_SATURATED = 0.95
_CLIP = 4.0
_ROUNDS = 20
# Range of light from which the slope of the line is known, linear light.
_MIN_LIGHT_SPREAD = 0.05
# Largest ratio of the variance at steep places to that at even ones; above it something has moved.
_MAX_STEEP_RATIO = 1.5
# Largest relative distance of the variances from the line of a sensor.
_MAX_FIT_ERROR = 0.25
# Noise in the dark below this share of the shot noise at the darkest place is hidden by it.
_MIN_DARK_SHARE = 0.2


@dataclasses.dataclass(frozen=True)
class SensorNoise:
    """Noise of one channel in linear light, as in camera files.

    Parameters
    ----------
    noise : float
        Standard deviation in the dark.
    noise_gain : float
        Variance of the shot noise per unit of light; 0 if the frames do not tell.
    darkest, brightest : float
        Range of light of the fitted line.
    gain_is_known : bool
        Whether light varies enough over the frames; if not, `noise` is that at their brightness.
    fit_error : float
        Median relative distance of the variances from the line.

    Examples
    --------
    See `noise_from_frames`.
    """

    noise: float
    noise_gain: float
    darkest: float
    brightest: float
    gain_is_known: bool
    fit_error: float

    @property
    def dark_is_extrapolated(self) -> bool:
        """Whether shot noise hides the noise in the dark wherever the frames have light."""
        return self.noise**2 < _MIN_DARK_SHARE * self.noise_gain * self.darkest


def noise_from_frames(frames: Sequence[NDArray[np.floating]]) -> SensorNoise:
    """Noise of a sensor from two or more frames of a static scene.

    Parameters
    ----------
    frames : sequence of ndarray of float, shape [rows, columns] or [rows, columns, 3]
        Linear light in [0, 1], of one size, with the same exposure. Textured or flat; the more the
        light varies over them, the better. Each is compared with the next.

    Returns
    -------
    SensorNoise

    Raises
    ------
    InputError
        If there is one frame only, sizes differ, nearly all is dark or saturated, frames are equal,
        or something moved.

    Examples
    --------
    >>> import numpy as np
    >>> random = np.random.default_rng(0)
    >>> light = np.linspace(0.1, 0.8, 200) * np.ones((200, 1))
    >>> frames = [light + 0.01 * random.standard_normal(light.shape) for _ in range(4)]
    >>> round(noise_from_frames(frames).noise, 3)
    0.01
    """
    if len(frames) < 2:
        raise InputError("one frame only: give two or more of the same scene")
    arrays = [np.asarray(frame, np.float64) for frame in frames]
    for number, array in enumerate(arrays[1:], start=2):
        if array.shape != arrays[0].shape:
            raise InputError(
                f"frame {number} has the shape {list(array.shape)}, the first one "
                f"{list(arrays[0].shape)}: frames of one camera are needed"
            )
    pairs = [_pair_samples(*pair) for pair in itertools.pairwise(arrays)]
    light, squares, steep = np.concatenate(pairs, axis=1)
    if len(light) < _MIN_PIXELS:
        raise InputError(
            f"only {len(light)} pixels are neither black nor saturated, {_MIN_PIXELS} are "
            "needed: change the exposure"
        )
    if not squares.any():
        raise InputError("the frames are equal: record each one separately")
    light, variance = _binned(light, squares, steep)
    dark, gain, fit_error = _robust_line(light, variance)
    if fit_error > _MAX_FIT_ERROR:
        raise InputError(
            f"the noise does not follow the light as a sensor's ({100 * fit_error:.0f} % off): "
            "something moved between the frames, or they are not linear light (gamma)"
        )
    darkest = float(light[0])
    brightest = float(light[-1])
    known = brightest - darkest >= _MIN_LIGHT_SPREAD
    if not known:
        dark = float(np.median(variance))
        gain = 0.0
    return SensorNoise(float(np.sqrt(dark)), gain, darkest, brightest, known, fit_error)


def _pair_samples(one: NDArray, two: NDArray) -> NDArray:
    """Light, variance and steepness of the usable pixels of two frames [3, pixels]."""
    usable = np.isfinite(one) & np.isfinite(two) & (np.minimum(one, two) > 0)
    usable &= np.maximum(one, two) < _SATURATED
    if not usable.any():
        return np.empty((3, 0))
    # Lamps flicker: the frames may differ in brightness as a whole.
    ratio = np.median(two[usable]) / np.median(one[usable])
    mean = (one + two / ratio) / 2
    even = ndimage.uniform_filter(mean, (3, 3, 1)[: mean.ndim])
    slopes = np.hypot(*(np.gradient(even, axis=axis) for axis in (0, 1)))
    squares = (one - two / ratio) ** 2 / (1 + 1 / ratio**2)
    # Sum and difference of the same noise are independent: sorted by the sum, the squares are fair.
    return np.stack([mean[usable], squares[usable], slopes[usable]])


def _binned(light: NDArray, squares: NDArray, steep: NDArray) -> tuple[NDArray, NDArray]:
    """Mean light and variance of groups of equally many pixels, darkest first."""
    bins = np.array_split(np.argsort(light, kind="stable"), _BINS)
    even = []
    uneven = []
    for group in bins:
        is_even = steep[group] <= np.median(steep[group])
        even.append(squares[group][is_even].mean())
        uneven.append(squares[group][~is_even].mean())
    if np.median(uneven) > _MAX_STEEP_RATIO * np.median(even):
        raise InputError(
            "the frames differ where the picture is steep: something moved between them; fix "
            "camera and scene, and use a remote release"
        )
    means = [light[group].mean() for group in bins]
    return np.array(means), np.array([_clipped_mean(squares[group]) for group in bins])


def _clipped_mean(squares: NDArray) -> float:
    """Mean square without outliers of the noise: sparks, dead pixels."""
    mean = float(squares.mean())
    for _ in range(3):
        kept = squares[squares <= _CLIP**2 * mean]
        mean = float(kept.mean()) if kept.size else mean
    return mean


def _robust_line(light: NDArray, variance: NDArray) -> tuple[float, float, float]:
    """Non-negative line fitted to relative errors (Huber): offset, slope, relative error."""
    terms = np.stack([np.ones_like(light), light], axis=1)
    least = 1e-3 * variance.mean() + 1e-30
    trust = np.ones_like(light)
    fitted = variance
    for _ in range(_ROUNDS):
        weights = trust / np.maximum(fitted, least)
        line, _ = optimize.nnls(terms * weights[:, None], variance * weights)
        fitted = terms @ line
        rest = np.abs(variance - fitted) / np.maximum(fitted, least)
        usual = max(1.4826 * float(np.median(rest)), 1e-12)
        trust = np.sqrt(np.minimum(1, 1.345 * usual / np.maximum(rest, 1e-12)))
    return float(line[0]), float(line[1]), float(np.median(rest))
