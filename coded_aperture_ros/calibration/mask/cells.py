"""Masks as square grids of cells, their autocorrelations, and phase retrieval.

Power spectra leave it open whether a mask is turned by 180 degrees, and so do these results.
"""

from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.optics import Mask

# Many starts are cheap; those that are behind after some steps seldom catch up.
_STARTS = 60
_FIRST_STEPS = 120
_KEPT = 20
_STEPS = 300


def square_cells(mask: Mask) -> DoubleArray:
    """Cells of a mask on a square grid [n, n] whose side is the mask's extent."""
    cells: DoubleArray = mask.transmission.astype(np.float64)
    side = max(cells.shape)
    if min(cells.shape) == side:
        return cells
    # Two cells for one, so that an odd difference of the sides can be halved.
    margins = [(side - length, side - length) for length in cells.shape]
    return np.pad(cells.repeat(2, axis=0).repeat(2, axis=1), margins)


def autocorrelation(parts: DoubleArray) -> DoubleArray:
    """Sum of the autocorrelations of grids [R, m, m]: [2m, 2m], lag zero first."""
    torus = (2 * parts.shape[1], 2 * parts.shape[2])
    return scipy.fft.irfft2((np.abs(scipy.fft.rfft2(parts, torus)) ** 2).sum(axis=0), torus)


def retrieve_masks(parts: DoubleArray, count: int) -> list[DoubleArray]:
    """Masks [m, m] whose autocorrelations are about the sum of those of the parts.

    Phase retrieval for a non-negative mask of limited support, the best of many random starts.
    """
    import scipy.optimize

    cells = parts.shape[-1]
    torus = (2 * cells, 2 * cells)
    wanted = autocorrelation(parts)

    def misfit(x: NDArray) -> tuple[float, NDArray]:
        transform = scipy.fft.rfft2(x.reshape(cells, cells), torus)
        error = scipy.fft.irfft2(np.abs(transform) ** 2, torus) - wanted
        slope = scipy.fft.irfft2(scipy.fft.rfft2(error) * transform, torus)[:cells, :cells]
        return 1e4 * float(np.sum(error**2)), 4e4 * slope.ravel()

    def improved(start: NDArray, steps: int) -> Any:
        return scipy.optimize.minimize(
            misfit, start, jac=True, method="L-BFGS-B",
            bounds=[(0, None)] * cells**2, options={"maxiter": steps},
        )  # fmt: skip

    random = np.random.default_rng(0)
    starts = [random.uniform(size=cells**2) ** 2 for _ in range(_STARTS)]
    found = [improved(start / start.sum(), _FIRST_STEPS) for start in starts]
    found.sort(key=lambda result: float(result.fun))
    found = [improved(result.x, _STEPS) for result in found[: max(count, _KEPT)]]
    found.sort(key=lambda result: float(result.fun))
    return [np.asarray(result.x).reshape(cells, cells) for result in found[:count]]
