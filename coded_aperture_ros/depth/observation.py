"""What is seen of one frame before its depth is estimated."""

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
    """One frame, patch by patch.

    `grey` is the mean of the channels [height, width], without NaN, and `noise` is of it;
    `brightness` and `usable`, where there are next to no saturated and missing pixels, are of the
    patches [rows, columns]. `unusable` are these pixels [height, width]; None if there are none.
    """

    grey: FloatArray
    grid: PatchGrid
    brightness: FloatArray
    usable: BoolArray
    noise: GreyNoise
    channels: int
    unusable: BoolArray | None = None

    @classmethod
    def of(
        cls,
        grey: FloatArray,
        unusable: BoolArray | None,
        grid: PatchGrid,
        known: KnownNoise,
        channels: int,
        least_noise: float = 0.0,
    ) -> "Observation":
        """Look at a frame by itself: what `grey_image` gives, and its channels' known noise.

        What compression has lost, `least_noise`, is in the mean of the channels as in each.
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
        """Standard deviation of one channel's noise, without shot noise."""
        return self.noise.sigma * float(np.sqrt(self.channels))
