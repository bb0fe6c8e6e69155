"""The likelihood of small patches, beside that of the model's: they see edges more sharply."""

import numpy as np

from coded_aperture_ros.bank import FilterBank, relearned
from coded_aperture_ros.core.arrays import FloatArray, IndexArray
from coded_aperture_ros.depth.observation import Observation
from coded_aperture_ros.depth.refine.cells import CELL_PX
from coded_aperture_ros.depth.refine.focal import Folding
from coded_aperture_ros.imaging import PatchGrid
from coded_aperture_ros.likelihood import Cost

# Side of the small patches: most blur still fits in.
SMALL_PX = 32


def small_bank(bank: FilterBank) -> FilterBank:
    """Return the bank of the small patches, for the sizes of a bank's levels without sign."""
    return relearned(bank, SMALL_PX, Folding.of(bank.blur_sizes_px).far)


class SmallPatches:
    """Gives the cost of small patches, for frames of one size; see `small_bank`."""

    def __init__(
        self, bank: FilterBank, shape: tuple[int, ...], backend: str = "numpy", threads: int = 1
    ) -> None:
        self._likelihood = bank.plan(shape, CELL_PX, backend, threads)

    @property
    def grid(self) -> PatchGrid:
        """Where the patches lie."""
        return self._likelihood.grid

    def cost(self, seen: Observation, grey: FloatArray, noise: float | FloatArray) -> Cost:
        """Return the cost of every blur size for every small patch.

        Parameters
        ----------
        seen : Observation
            The frame.
        grey : ndarray, float32 [height, width]
            The frame, or a mean of frames.
        noise : float, or ndarray, float32 [rows, columns]
            Its standard deviation, of the frame or around every patch of the model.
        """
        nearest = _nearest(seen.grid, self.grid)
        if isinstance(noise, np.ndarray):
            noise = np.ascontiguousarray(noise[nearest])
        return self._likelihood.cost(grey, noise, seen.usable[nearest])

    def close(self) -> None:
        """End the threads that the work was shared among."""
        self._likelihood.close()


def _nearest(of: PatchGrid, to: PatchGrid) -> tuple[IndexArray, ...]:
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
