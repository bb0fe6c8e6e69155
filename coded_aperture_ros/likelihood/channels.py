"""Cost of frames whose colour channels have PSFs of their own."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray, PerPatch
from coded_aperture_ros.likelihood.backends import EngineLikelihood
from coded_aperture_ros.likelihood.protocol import Cost, Likelihood


class ChannelLikelihood:
    """Adds the costs of the colour channels, each by its own PSFs; a `Likelihood`.

    The noise of the channels is independent, so their likelihoods are multiplied. Relations between
    the channels, as of the phases of one texture in all of them, are left out.

    Parameters
    ----------
    grey : EngineLikelihood
        Of the mean of the channels, for frames without colour.
    channels : sequence of Likelihood
        Of each channel, in the order of the frames' channels.
    """

    def __init__(self, grey: EngineLikelihood, channels: Sequence[Likelihood]) -> None:
        self.backend = grey.backend
        self.grid = grey.grid
        self._grey = grey
        self._channels = tuple(channels)

    def cost(
        self, light: FloatArray, noise: PerPatch, usable: BoolArray | None = None, prior: Any = None
    ) -> Cost:
        """Cost of every level for every patch; see `Likelihood.cost`.

        `light` is float32 [height, width, C], or [height, width] where a frame has no colour;
        `noise` is that of the mean of the channels.
        """
        if light.ndim == 2:
            return self._grey.cost(light, noise, usable, prior)
        of_one: Any = noise * np.float32(np.sqrt(len(self._channels)))
        costs = [
            likelihood.cost(np.ascontiguousarray(light[..., channel]), of_one, usable, prior)
            for channel, likelihood in enumerate(self._channels)
        ]
        volume = np.sum([cost.volume for cost in costs], axis=0)
        least = volume.min(axis=-1, keepdims=True)
        periodic = [cost.periodic for cost in costs if cost.periodic is not None]
        step = costs[0].periodic_step
        return Cost(
            volume - least,
            np.mean([cost.misfit for cost in costs if cost.misfit is not None], axis=0),
            periodic=np.sum(periodic, axis=0) - least[::step, ::step] if periodic else None,
            periodic_step=step,
            seconds={part: sum(cost.seconds[part] for cost in costs) for part in costs[0].seconds},
        )

    def close(self) -> None:
        """Release threads and device memory."""
        for likelihood in (self._grey, *self._channels):
            likelihood.close()
