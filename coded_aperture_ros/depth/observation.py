"""Grey image, patches and noise of one frame, before its depth is estimated."""

import dataclasses

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.frames import (
    GreyNoise,
    KnownNoise,
    PatchGrid,
    grey_noise,
    usable_windows,
    window_brightness,
)


@dataclasses.dataclass(frozen=True, eq=False)
class Observation:
    """Grey image of a frame, with brightness and usability of its patches, and noise.

    Attributes
    ----------
    grey : ndarray, float32 [height, width]
        Mean of the channels, linear light, without NaN.
    grid : PatchGrid
        Positions of the patches.
    brightness : ndarray, float32 [rows, columns]
        Mean linear light of each patch.
    usable : ndarray, bool [rows, columns]
        Patches with next to no saturated or missing pixels.
    noise : GreyNoise
        Of `grey`.
    channels : int
        Channels that `grey` is the mean of.
    unusable : ndarray, bool [height, width], or None
        Saturated and missing pixels; None if there are none.
    """

    grey: FloatArray
    grid: PatchGrid
    brightness: FloatArray
    usable: BoolArray
    noise: GreyNoise
    channels: int
    unusable: BoolArray | None = None

    @classmethod
    def from_grey(
        cls,
        grey: FloatArray,
        unusable: BoolArray | None,
        grid: PatchGrid,
        known: KnownNoise,
        channels: int,
        least_noise: float = 0.0,
    ) -> "Observation":
        """Observation of a frame.

        Parameters
        ----------
        grey, unusable : ndarray
            As `grey_image` returns them.
        grid : PatchGrid
        known : KnownNoise
            Of one channel.
        channels : int
        least_noise : float
            Lower bound of the standard deviation of `grey`'s noise, linear light. Averaging the
            channels does not lower it: the error of compression is the same in all of them.
        """
        brightness = window_brightness(grey, grid)
        usable = np.full(brightness.shape, True)
        if unusable is not None:
            usable = usable_windows(unusable, grid)
        noise = grey_noise(grey, grid, known, channels, brightness, usable)
        if noise.sigma < least_noise:
            noise = dataclasses.replace(noise, sigma=least_noise)
        return cls(grey, grid, brightness, usable, noise, channels, unusable)

    @property
    def channel_noise(self) -> float:
        """Standard deviation of one channel's noise, linear light, without shot noise."""
        return self.noise.sigma * float(np.sqrt(self.channels))
