"""The likelihood of a filter bank: spectra in the common basis, and the cost of every level."""

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.stages import Stages
from coded_aperture_ros.imaging import PatchGrid
from coded_aperture_ros.likelihood.backends import Engine
from coded_aperture_ros.likelihood.protocol import Cost
from coded_aperture_ros.likelihood.scoring import relative_cost


class FilterLikelihood:
    """Cost volumes of frames of one size by a filter bank; see `Likelihood`.

    Parameters
    ----------
    engine : Engine
        Computes the energies of the bank's plan.
    grid : PatchGrid
        Where its patches lie.
    window_correlation : float
        See `relative_cost`.
    """

    def __init__(self, engine: Engine, grid: PatchGrid, window_correlation: float) -> None:
        self.grid = grid
        self._engine = engine
        self._window_correlation = window_correlation

    @property
    def backend(self) -> str:
        """What computes: `numpy`, `torch` or `cuda`."""
        return self._engine.name

    def cost(
        self,
        grey: NDArray[np.float32],
        noise: float | NDArray[np.float32],
        usable: NDArray[np.bool_] | None = None,
        prior: object = None,
    ) -> Cost:
        """Return the cost volume of a frame; see `Likelihood.cost`."""
        stages = Stages()
        self._engine.project(grey)
        stages.lap("spectra")
        energies = self._engine.energies(noise)
        volume = relative_cost(energies, self._window_correlation, usable)
        stages.lap("energies")
        return Cost(volume, seconds=stages.seconds)

    def close(self) -> None:
        """End the engine's threads, and let go of its memory."""
        self._engine.close()
