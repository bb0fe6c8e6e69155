"""What the network is shown of a frame: the model's patches, and smaller ones for edges."""

import numpy as np

from coded_aperture_ros.bank import FilterBank
from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.refine.cells import CELL_PX
from coded_aperture_ros.depth.refine.features import Look
from coded_aperture_ros.imaging import PatchGrid
from coded_aperture_ros.likelihood import Cost

# Side of the smaller patches: what is wider has a patch of its own, and most blur fits in.
SMALL_PX = 32


class SmallPatches:
    """The likelihood of patches that are smaller than the model's, for frames of one size.

    Takes a bank whose window is `SMALL_PX`.
    """

    def __init__(
        self, bank: FilterBank, shape: tuple[int, ...], backend: str = "numpy", threads: int = 1
    ) -> None:
        self._likelihood = bank.plan(shape, CELL_PX, backend, threads)

    def look(self, seen: Observation) -> Look:
        """Return what the small patches tell about a frame."""
        grid = self._likelihood.grid
        nearest = _nearest(seen.grid, grid)
        noise = seen.noise.deviation
        if not isinstance(noise, float):
            noise = np.ascontiguousarray(noise[nearest])
        return look(self._likelihood.cost(seen.grey, noise, seen.usable[nearest]), grid)

    def close(self) -> None:
        """End the threads that the work was shared among."""
        self._likelihood.close()


def look(cost: Cost, grid: PatchGrid, volume: FloatArray | None = None) -> Look:
    """Return what patches tell, by the cost of this frame or by another volume."""
    volume = cost.volume if volume is None else volume
    misfit = np.zeros(volume.shape[:2], np.float32) if cost.misfit is None else cost.misfit
    return Look(volume, misfit, grid)


def _nearest(of: PatchGrid, to: PatchGrid) -> tuple[IndexArray, IndexArray]:
    """Return the patch of one grid that is nearest to every patch of another."""
    rows, columns = (
        np.rint((np.asarray(wanted) - centres[0]) / of.stride_px)
        .clip(0, len(centres) - 1)
        .astype(np.intp)
        for centres, wanted in (
            (of.row_centres, to.row_centres),
            (of.column_centres, to.column_centres),
        )
    )
    return np.ix_(rows, columns)
