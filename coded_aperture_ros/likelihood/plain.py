"""The engine of banks that are only there for comparison."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.imaging import PatchGrid


class PlainEngine:
    """Lets a bank that says how to project a frame do so itself; see `Engine`.

    Parameters
    ----------
    bank : SubspaceBank
        Anything with its `project` and `energies`.
    shape : (int, int)
        Rows and columns of the frames.
    stride_px : int
        Distance between patches, px.
    """

    name = "plain"

    def __init__(self, bank: Any, shape: tuple[int, ...], stride_px: int) -> None:
        self._bank, self._stride_px = bank, stride_px
        self._frame = bank.project(np.zeros(shape[:2], np.float32), stride_px)

    @property
    def grid(self) -> PatchGrid:
        """Where the patches lie."""
        grid: PatchGrid = self._frame.grid
        return grid

    def project(self, grey: NDArray[np.float32]) -> None:
        """Take a frame [rows, columns]."""
        self._frame = self._bank.project(grey, self._stride_px)

    def energies(self, noise: float | NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the energy of every level for every patch [rows, columns, L]."""
        energies: NDArray[np.float32] = self._bank.energies(self._frame, noise)
        return energies

    def close(self) -> None:
        """Do nothing: there is nothing to let go of."""
