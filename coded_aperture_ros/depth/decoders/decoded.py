"""Result of a decoder: level, deviation, confidence and quantiles of every pixel."""

from typing import Protocol

from coded_aperture_ros.core.arrays import FloatArray


class Decoded(Protocol):
    """Level of every pixel and its uncertainty; maps are float32 of one shape [rows, columns]."""

    @property
    def level(self) -> FloatArray:
        """Fractional index into the model's levels."""

    @property
    def deviation(self) -> FloatArray:
        """Standard deviation of the level, in levels."""

    @property
    def confidence(self) -> FloatArray:
        """Probability, in [0, 1], that the level is right; see `DepthEstimate`."""

    @property
    def side_confidence(self) -> FloatArray | None:
        """Probability, in [0, 1], that the level's side of the focal plane is the right one."""

    def quantile(self, probability: float) -> FloatArray:
        """Level that the true one is nearer than with a probability; keeps depth edges."""

    def nearest_around(self, probability: float) -> FloatArray | None:
        """Level that what a pixel and its surroundings show is nearer than with a probability.

        None if the decoder cannot tell.
        """
