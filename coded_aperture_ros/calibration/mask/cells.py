"""Masks as square grids of cells, and what spectra tell of them: autocorrelations."""

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.optics import Mask


def square_cells(mask: Mask) -> NDArray[np.float64]:
    """Return a mask's cells on a square grid, whose side is the mask's extent [n, n]."""
    cells: NDArray[np.float64] = mask.transmission.astype(np.float64)
    side = max(cells.shape)
    if min(cells.shape) == side:
        return cells
    # Two cells for one, so that an odd difference of the sides can be halved.
    margins = [(side - length, side - length) for length in cells.shape]
    return np.pad(cells.repeat(2, axis=0).repeat(2, axis=1), margins)


def autocorrelation(parts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of the autocorrelations of grids [R, m, m]: [2m, 2m], lag zero first."""
    torus = (2 * parts.shape[1], 2 * parts.shape[2])
    return np.asarray(
        scipy.fft.irfft2((np.abs(scipy.fft.rfft2(parts, torus)) ** 2).sum(axis=0), torus)
    )
