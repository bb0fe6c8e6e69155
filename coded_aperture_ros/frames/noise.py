"""The noise of a frame: what is known of it beforehand, or else the top of its spectrum.

A blurred texture has next to nothing at the highest frequencies; what is there is noise.
"""

import dataclasses
from typing import Protocol

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, PerPatch
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames.grey import grey_image
from coded_aperture_ros.frames.patches import PatchGrid, window_brightness, window_means

# Passes what alternates from pixel to pixel along rows and columns both, and white noise with its
# variance unchanged: a texture, blurred or not, has next to nothing there. A sharper filter would
# miss noise that a sensor's colour filters have smoothed.
ALTERNATING = (np.array([1, -2, 1]) / np.sqrt(6)).astype(np.float32)
# Passes half these frequencies, which colour filters leave, and more texture: less of it counts.
# On the real photograph it finds three times as much noise, of a frame with white noise no more.
HALF_AS_FAST = (np.array([1, 0, -2, 0, 1]) / np.sqrt(6)).astype(np.float32)
_OF_HALF_AS_FAST = 0.8

# The least textured windows tell the noise best; the very least are there by chance.
_QUANTILE = 0.05
_DARKEST = 0.25
# Noise that is taken too low is fatal for the estimate, too high only costs a little.
_MARGIN = 1.2
# Of whole frames, sparse windows tell enough; saturation does not matter to their noise.
_WINDOW_PX, _LEAST_WINDOW_PX = 32, 8
_NEVER_SATURATED = 1e9
# Real frames are not cleaner than this, whatever their spectrum says.
NOISE_FLOOR = 2e-4


def high_power(grey: FloatArray, grid: PatchGrid, kernel: FloatArray = ALTERNATING) -> FloatArray:
    """Return the mean power of the highest frequencies around every patch [rows, columns].

    It is the variance of the noise, and what little there is of texture. The `kernel` passes them.
    """
    passed = cv2.sepFilter2D(grey, -1, kernel, kernel)
    cv2.multiply(passed, passed, passed)
    return window_means(passed, grid, grid.window_px * 3 // 4)


def estimate_noise(high_power: FloatArray, shot_variance: FloatArray | None = None) -> float:
    """Estimate the standard deviation of white noise, erring upward; at least `NOISE_FLOOR`.

    From the `high_power` of a frame's windows. The variance of shot noise, of the same shape, is
    what is known of the noise, and left out of the estimate.
    """
    variance = _MARGIN**2 * high_power
    if shot_variance is not None:
        # Where there is much light, its noise hides the rest.
        darkest = shot_variance <= np.quantile(shot_variance, _DARKEST)
        variance = (variance - shot_variance)[darkest]
    return float(np.sqrt(max(np.quantile(variance, _QUANTILE), NOISE_FLOOR**2)))


class HasNoise(Protocol):
    """Settings, a camera or a model that may know the noise; `noise_gain` is optional."""

    @property
    def noise(self) -> float:
        """Standard deviation of one channel's noise in the dark; 0: not known."""


@dataclasses.dataclass(frozen=True)
class KnownNoise:
    """Noise of one channel, linear light, as far as it is known before a frame is seen."""

    noise: float = 0.0  # standard deviation in the dark; 0: it is estimated in each frame
    noise_gain: float = 0.0  # variance of shot noise per unit of light; 0: none

    @classmethod
    def from_sources(cls, *sources: HasNoise | None) -> "KnownNoise":
        """Take each value from the first source that has it.

        This is the one precedence of the whole package: options that were set, then the camera
        file, then the filter bank; and what none of them knows is estimated.
        """
        values = [
            next((found for source in sources if (found := getattr(source, name, 0.0))), 0.0)
            for name in ("noise", "noise_gain")
        ]
        return cls(*values)


@dataclasses.dataclass(frozen=True, eq=False)
class GreyNoise:
    """Noise of the mean of a frame's channels."""

    sigma: float  # standard deviation, without shot noise
    # [rows, columns]; of the shot noise around every patch, if it is known.
    shot_variance: FloatArray | None = None
    # As `sigma`, from the highest frequencies alone, where it was estimated: fine texture counts
    # less there, and the noise of colour sensors, too.
    highest: float | None = None

    @property
    def least(self) -> float:
        """What frames of a static scene differ by at least: of the highest frequencies alone."""
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
        if self.shot_variance is None:
            return self.sigma
        return float(np.sqrt(self.sigma**2 + np.median(self.shot_variance)))


def grey_noise(
    grey: FloatArray,
    grid: PatchGrid,
    known: KnownNoise,
    channels: int = 1,
    brightness: FloatArray | None = None,
    usable: BoolArray | None = None,
) -> GreyNoise:
    """Return the noise of a frame: what is known of it, and an estimate of the rest.

    `grey`, float32 [height, width], is the mean of so many `channels`, which has less noise than
    each of them; `grid` says where to look. Shot noise needs the brightness around every patch
    [rows, columns]; `usable` are the patches without pixels that were filled in: these have no
    noise.
    """
    shot_variance = None
    if known.noise_gain and brightness is not None:
        shot_variance = np.float32(known.noise_gain / channels) * np.maximum(brightness, 0)
    if known.noise:
        return GreyNoise(known.noise / float(np.sqrt(channels)), shot_variance)
    telling = np.ones((grid.rows, grid.columns), np.bool_)
    if usable is not None:
        telling = usable if usable.any() else ~usable
    shot = None if shot_variance is None else shot_variance[telling]
    highest = estimate_noise(high_power(grey, grid)[telling], shot)
    # Noise that a sensor's colour filters have smoothed is missing from the highest frequencies.
    lower = estimate_noise(high_power(grey, grid, HALF_AS_FAST)[telling], shot)
    return GreyNoise(max(highest, _OF_HALF_AS_FAST * lower), shot_variance, highest)


def channel_noise(frame: FloatArray, known: KnownNoise) -> float:
    """Return the standard deviation of one channel's noise in a frame, with its shot noise.

    What deblurring reckons with, in nodes, commands and bags alike. The frame, float32 [rows,
    columns] or [rows, columns, 3], is linear light; NaN where unknown. Raises `InputError` if the
    noise has to be estimated and the frame is too small for that.
    """
    # Sensors sample green the most; the mean of the channels would count their texture thrice.
    grey, _ = grey_image(frame if frame.ndim == 2 else frame[..., 1], _NEVER_SATURATED)
    sigma = known.noise
    if not sigma:
        height, width = grey.shape
        window_px = min(_WINDOW_PX, 2 * (min(height, width) // 2))
        if window_px < _LEAST_WINDOW_PX:
            raise InputError(
                f"frame of {width}x{height} px is too small to estimate its noise, give the noise"
            )
        grid = PatchGrid.covering(grey.shape, window_px, window_px)
        sigma = grey_noise(grey, grid, known, brightness=window_brightness(grey, grid)).least
    light = max(float(grey.mean()), 0.0) if known.noise_gain else 0.0
    return float(np.sqrt(sigma**2 + known.noise_gain * light))
