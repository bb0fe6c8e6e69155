"""A sensor's noise from frames of something that does not move: the photon transfer method.

The difference of two frames of the same has no texture, only the noise of both. Its variance grows
with the light: a line whose height in the dark is the noise of reading out, and whose slope is the
shot noise per unit of light.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, optimize

from coded_aperture_ros.core.errors import InputError

_BINS = 48
_FEWEST_PIXELS = 2_000
_SATURATED = 0.95
_CLIP = 4.0
_ROUNDS = 20
# Brightest over darkest twentieth, in light, from which the slope of the line can be told.
_LEAST_SPREAD = 0.05
# Variance where the picture is steep over that where it is even, from which something has moved.
_MOVED = 1.5
# How far the noise may be off the line of a sensor's.
_MOST_OFF = 0.25
# Noise in the dark below this share of the shot noise at the darkest place is lost in it.
_HIDDEN = 0.2


@dataclasses.dataclass(frozen=True)
class SensorNoise:
    """Noise of one channel in linear light, as camera files have it.

    Attributes
    ----------
    noise : float
        Standard deviation in the dark.
    noise_gain : float
        Variance of the shot noise per unit of light; 0 where the frames cannot tell it.
    darkest, brightest : float
        Light that the line was fitted between.
    gain_is_known : bool
        Whether light varies enough over the frames; if not, `noise` is that at their brightness.
    fit_error : float
        Typical distance of the variances from the line, relative.
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
        return self.noise**2 < _HIDDEN * self.noise_gain * self.darkest


def noise_from_frames(frames: Sequence[NDArray[np.floating]]) -> SensorNoise:
    """Measure the noise from two or more frames of a scene that does not move.

    Parameters
    ----------
    frames : sequence of ndarray of float, shape [rows, columns] or [rows, columns, 3]
        Linear light in [0, 1], of one size, with the same exposure. Textured or flat; the more
        the light varies over them, the better. Each is compared with the next.

    Raises
    ------
    InputError
        If there is one frame only, sizes differ, nearly all is dark or saturated, frames are equal,
        or something moved.
    """
    if len(frames) < 2:
        raise InputError("one frame does not tell noise from texture: give two or more of the same")
    arrays = [np.asarray(frame, np.float64) for frame in frames]
    for number, array in enumerate(arrays[1:], start=2):
        if array.shape != arrays[0].shape:
            raise InputError(
                f"frame {number} has the shape {list(array.shape)}, the first one "
                f"{list(arrays[0].shape)}: frames of one camera are needed"
            )
    pairs = [_compared(*pair) for pair in itertools.pairwise(arrays)]
    light, squares, steep = np.concatenate(pairs, axis=1)
    if len(light) < _FEWEST_PIXELS:
        raise InputError(
            f"only {len(light)} pixels are neither black nor saturated, {_FEWEST_PIXELS} are "
            "needed: change the exposure"
        )
    if not squares.any():
        raise InputError("the frames are equal: take each one anew")
    light, variance = _binned(light, squares, steep)
    dark, gain, fit_error = _robust_line(light, variance)
    if fit_error > _MOST_OFF:
        raise InputError(
            f"the noise does not go by the light as a sensor's does ({100 * fit_error:.0f} % off): "
            "something moved between the frames, or they are not linear light (gamma)"
        )
    darkest = float(light[0])
    brightest = float(light[-1])
    known = brightest - darkest >= _LEAST_SPREAD
    if not known:
        dark = float(np.median(variance))
        gain = 0.0
    return SensorNoise(float(np.sqrt(dark)), gain, darkest, brightest, known, fit_error)


def _compared(one: NDArray, two: NDArray) -> NDArray:
    """Return light, variance and steepness of the usable pixels of two frames [3, pixels]."""
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
    """Return mean light and variance of groups of equally many pixels, darkest first."""
    bins = np.array_split(np.argsort(light, kind="stable"), _BINS)
    even = []
    uneven = []
    for group in bins:
        is_even = steep[group] <= np.median(steep[group])
        even.append(squares[group][is_even].mean())
        uneven.append(squares[group][~is_even].mean())
    if np.median(uneven) > _MOVED * np.median(even):
        raise InputError(
            "the frames differ where the picture is steep: something moved between them; fix "
            "camera and scene, and use a remote release"
        )
    means = [light[group].mean() for group in bins]
    return np.array(means), np.array([_clipped_mean(squares[group]) for group in bins])


def _clipped_mean(squares: NDArray) -> float:
    """Return the mean square without what noise does not explain: sparks, dead pixels."""
    mean = float(squares.mean())
    for _ in range(3):
        kept = squares[squares <= _CLIP**2 * mean]
        mean = float(kept.mean()) if kept.size else mean
    return mean


def _robust_line(light: NDArray, variance: NDArray) -> tuple[float, float, float]:
    """Fit a line, never negative, to relative errors (Huber): dark, slope, relative error."""
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
