"""Grey image, patches and noise of one frame, before its depth is estimated."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, namespace
from coded_aperture_ros.frames import (
    GreyNoise,
    KnownNoise,
    PatchGrid,
    grey_image,
    grey_noise,
    usable_windows,
    window_brightness,
)


@dataclasses.dataclass(frozen=True, eq=False)
class Observation:
    """Grey image of a frame, with brightness and usability of its patches, and noise.

    Attributes
    ----------
    light : ndarray, float32 [height, width] or [height, width, C]
        Of the frame's channels, linear, without NaN.
    grey : ndarray, float32 [height, width]
        Mean of the channels.
    grid : PatchGrid
        Positions of the patches.
    brightness : ndarray, float32 [rows, columns]
        Mean linear light of each patch.
    usable : ndarray, bool [rows, columns]
        Patches with next to no saturated or missing pixels.
    noise : GreyNoise
        Of `grey`.
    unusable : ndarray, bool [height, width], or None
        Saturated and missing pixels; None if there are none.
    """

    light: FloatArray
    grey: FloatArray
    grid: PatchGrid
    brightness: FloatArray
    usable: BoolArray
    noise: GreyNoise
    unusable: BoolArray | None = None

    @classmethod
    def from_light(
        cls,
        light: FloatArray,
        saturation: float,
        grid: PatchGrid,
        known: KnownNoise,
        least_noise: float = 0.0,
    ) -> "Observation":
        """Observation of a frame.

        Parameters
        ----------
        light : ndarray, float32 [height, width] or [height, width, C]
            Linear; NaN where missing.
        saturation : float
            Brightness from which pixels are not used.
        grid : PatchGrid
        known : KnownNoise
            Of one channel.
        least_noise : float
            Lower bound of the standard deviation of `grey`'s noise, linear light. Averaging the
            channels does not lower it: the error of compression is the same in all of them.
        """
        xp, (grey, unusable) = namespace(light), grey_image(light, saturation)
        brightness = window_brightness(grey, grid)
        usable = xp.isfinite(brightness)  # all
        if unusable is not None:
            usable = usable_windows(unusable, grid)
            filler = grey if light.ndim == 2 else grey[..., None]
            light = xp.where(xp.isfinite(light), light, filler)
        channels = 1 if light.ndim == 2 else light.shape[2]
        noise = grey_noise(grey, grid, known, channels, brightness, usable)
        if noise.sigma < least_noise:
            noise = dataclasses.replace(noise, sigma=least_noise)
        return cls(light, grey, grid, brightness, usable, noise, unusable)

    @property
    def channels(self) -> int:
        """Channels that `grey` is the mean of."""
        return 1 if self.light.ndim == 2 else self.light.shape[2]

    @property
    def channel_noise(self) -> float:
        """Standard deviation of one channel's noise, linear light, without shot noise."""
        return self.noise.sigma * float(np.sqrt(self.channels))
