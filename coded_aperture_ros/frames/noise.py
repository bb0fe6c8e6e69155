"""Noise of a frame: known beforehand, or estimated from its highest frequencies.

Blur removes almost all texture at the highest frequencies; the rest is noise.
"""

import dataclasses
from typing import Protocol

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, PerPatch, filters, in_memory
from coded_aperture_ros.frames.patches import PatchGrid, window_means

# High-pass filter of unit energy, for rows and columns both: texture, blurred or not, has almost no
# power there. A sharper filter would miss noise that a sensor's colour filters have smoothed.
ALTERNATING = (np.array([1, -2, 1]) / np.sqrt(6)).astype(np.float32)
# The same at half the frequencies, which colour filters leave, with more texture and a lower
# weight. In a real photograph it finds three times as much noise, in white noise no more.
HALF_AS_FAST = (np.array([1, 0, -2, 0, 1]) / np.sqrt(6)).astype(np.float32)
_HALF_AS_FAST_WEIGHT = 0.8

# Quantile of the power of windows: the least textured ones show the noise best, the very least are
# so by chance.
_QUANTILE = 0.05
# Share of the windows with the least light, where shot noise hides the rest of the noise least.
_DARKEST_SHARE = 0.25
# Factor on the estimate: too low a noise is fatal for depth, too high costs little accuracy.
_MARGIN = 1.2
# No real frame has less noise, standard deviation, linear light.
NOISE_FLOOR = 2e-4


def high_power(grey: FloatArray, grid: PatchGrid, kernel: FloatArray = ALTERNATING) -> FloatArray:
    """Mean power of the highest frequencies around every patch [rows, columns].

    It is the variance of the noise, and of little texture.

    Parameters
    ----------
    grey : ndarray, float32 [height, width]
        Or a tensor; its device is waited for.
    grid : PatchGrid
    kernel : ndarray, float32 [k]
        High-pass filter of unit energy.
    """
    passed = filters(grey).sepFilter2D(grey, -1, kernel, kernel)
    passed *= passed
    return in_memory(window_means(passed, grid, grid.window_px * 3 // 4))


def estimate_noise(high_power: FloatArray, shot_variance: FloatArray | None = None) -> float:
    """Standard deviation of white noise, rather too high than too low; at least `NOISE_FLOOR`.

    Parameters
    ----------
    high_power : ndarray, float32 [n]
        Of a frame's windows; see `high_power`.
    shot_variance : ndarray, float32 [n], optional
        Known variance of shot noise, which is subtracted.

    Examples
    --------
    >>> round(estimate_noise(np.full(100, 1e-4, np.float32)), 4)
    0.012
    """
    variance = _MARGIN**2 * high_power
    if shot_variance is not None:
        darkest = shot_variance <= np.quantile(shot_variance, _DARKEST_SHARE)
        variance = (variance - shot_variance)[darkest]
    return float(np.sqrt(max(np.quantile(variance, _QUANTILE), NOISE_FLOOR**2)))


class HasNoise(Protocol):
    """Settings, camera or model with a noise, and optionally a `noise_gain`."""

    @property
    def noise(self) -> float:
        """Standard deviation of one channel's noise in the dark, linear light; 0: unknown."""


@dataclasses.dataclass(frozen=True)
class KnownNoise:
    """Noise of one channel, linear light, as far as it is known before a frame is measured.

    Examples
    --------
    >>> KnownNoise.from_sources(KnownNoise(), KnownNoise(0.002, 1e-4))
    KnownNoise(noise=0.002, noise_gain=0.0001)
    """

    noise: float = 0.0  # standard deviation in the dark; 0: it is estimated in each frame
    noise_gain: float = 0.0  # variance of shot noise per unit of light; 0: none

    @classmethod
    def from_sources(cls, *sources: HasNoise | None) -> "KnownNoise":
        """Each value of the first source that has it.

        The order is the same for depth (`DepthEstimator`) and deblurring (`FramePipeline`): options
        that were set, then the camera file, then the filter bank; otherwise noise is estimated.
        """
        values = [
            next((value for source in sources if (value := getattr(source, name, 0.0))), 0.0)
            for name in ("noise", "noise_gain")
        ]
        return cls(*values)


@dataclasses.dataclass(frozen=True, eq=False)
class GreyNoise:
    """Noise of the mean of a frame's channels, linear light.

    Examples
    --------
    >>> round(GreyNoise(0.003, np.full((2, 2), 1.6e-5, np.float32)).typical, 6)
    0.005
    """

    sigma: float  # standard deviation, without shot noise
    # [rows, columns]; variance of the shot noise around every patch, if it is known.
    shot_variance: FloatArray | None = None
    # As `sigma`, from the highest frequencies alone, where it was estimated: fine texture counts
    # less there, and the noise of colour sensors, too.
    highest: float | None = None

    @property
    def least(self) -> float:
        """Standard deviation from the highest frequencies alone: least noise of static frames."""
        return self.sigma if self.highest is None else self.highest

    @property
    def deviation(self) -> PerPatch:
        """Standard deviation with shot noise, of the frame or around every patch."""
        if self.shot_variance is None:
            return self.sigma
        return np.sqrt(self.sigma**2 + self.shot_variance, dtype=np.float32)

    @property
    def typical(self) -> float:
        """Standard deviation of the frame as a whole, with shot noise."""
        # Python's numbers: NumPy's of double precision would make arrays as precise.
        if self.shot_variance is None:
            return float(self.sigma)
        return float(np.sqrt(self.sigma**2 + np.median(self.shot_variance)))


def grey_noise(
    grey: FloatArray,
    grid: PatchGrid,
    known: KnownNoise,
    channels: int = 1,
    brightness: FloatArray | None = None,
    usable: BoolArray | None = None,
) -> GreyNoise:
    """Noise of a grey frame: as far as it is known, and else estimated.

    Parameters
    ----------
    grey : ndarray, float32 [height, width]
        Mean of the channels, which has less noise than each of them.
    grid : PatchGrid
        Windows whose noise is estimated.
    known : KnownNoise
        Of one channel.
    channels : int
    brightness : ndarray, float32 [rows, columns], optional
        Around every patch, needed for shot noise.
    usable : ndarray, bool [rows, columns], optional
        Patches without pixels that were filled in, as these have no noise.

    Examples
    --------
    >>> grid = PatchGrid.covering((64, 64), window_px=32, stride_px=8)
    >>> frame = np.random.default_rng(0).normal(0.5, 0.01, (64, 64)).astype(np.float32)
    >>> bool(0.008 < grey_noise(frame, grid, KnownNoise()).sigma < 0.014)
    True
    """
    shot_variance = None
    if known.noise_gain and brightness is not None:
        light = np.maximum(in_memory(brightness), 0)
        shot_variance = np.float32(known.noise_gain / channels) * light
    if known.noise:
        return GreyNoise(known.noise / float(np.sqrt(channels)), shot_variance)
    measured = np.ones((grid.rows, grid.columns), np.bool_)
    if usable is not None:
        usable = in_memory(usable)
        measured = usable if usable.any() else ~usable
    shot = None if shot_variance is None else shot_variance[measured]
    highest = estimate_noise(high_power(grey, grid)[measured], shot)
    # Noise that a sensor's colour filters have smoothed is missing from the highest frequencies.
    lower = estimate_noise(high_power(grey, grid, HALF_AS_FAST)[measured], shot)
    return GreyNoise(max(highest, _HALF_AS_FAST_WEIGHT * lower), shot_variance, highest)
