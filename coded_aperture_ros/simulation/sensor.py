"""The sensor: noise and quantisation."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError


@dataclasses.dataclass(frozen=True)
class SensorModel:
    """Additive Gaussian noise, then rounding to steps.

    Attributes
    ----------
    noise : float
        Standard deviation, 1 = full scale.
    bits : {0, 8, 12, 16}
        Values are clipped to 0..1 and rounded to `2**bits - 1` steps; 0 leaves them as they are.
    """

    noise: float = 0.0
    bits: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.noise <= 1:
            raise InputError(f"noise: expected 0 to 1 (full scale), got {self.noise!r}")
        if self.bits not in (0, 8, 12, 16):
            raise InputError(f"bits: expected 0, 8, 12 or 16, got {self.bits!r}")

    def expose(self, image: NDArray, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the image as the sensor reads it out; float32, linear, shape of `image`."""
        exposed = np.array(image, dtype=np.float32)
        if self.noise:
            exposed += np.float32(self.noise) * rng.standard_normal(exposed.shape, np.float32)
        if self.bits:
            steps = np.float32(2**self.bits - 1)
            exposed = np.rint(np.clip(exposed, 0.0, 1.0) * steps) / steps
        return exposed
