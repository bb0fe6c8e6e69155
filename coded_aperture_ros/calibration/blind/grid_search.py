"""Phase retrieval with binary cells: the open and closed cells that explain the spectra best.

Grey grids of no negative values first, from random starts: they are easy to improve. The threshold
is the one that explains the spectra best; then single cells are opened and closed, also where it
gets worse for a while.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.blind.grid_misfit import GridMisfit

_GREY_STEPS = 150
_FLIPS, _PATIENCE = 200, 40
# A cell that was changed stays for so many steps (tabu search).
_REST, _REST_SPREAD = 8, 6
_FEWEST_OPEN = 2


@dataclasses.dataclass(frozen=True, eq=False)
class BinaryGrid:
    """Open (1) and closed (0) cells [n, n], and how badly they explain the spectra."""

    cells: NDArray[np.float64]
    misfit: float


def best_grid(
    misfit: GridMisfit,
    starts: int,
    random: np.random.Generator,
    grids: Sequence[NDArray[np.float64]] = (),
) -> BinaryGrid:
    """Return the best grid found from random starts and from binary grids."""
    begun = [improved(misfit, grid, random) for grid in grids]
    for _ in range(starts):
        grey = _grey(misfit, random.random((misfit.cells, misfit.cells)))
        begun.append(improved(misfit, _thresholded(misfit, grey), random))
    return min(begun, key=lambda found: found.misfit)


def _grey(misfit: GridMisfit, start: NDArray) -> NDArray:
    import scipy.optimize

    result = scipy.optimize.minimize(
        misfit.value_and_gradient, start.ravel(), jac=True, method="L-BFGS-B",
        bounds=[(0, None)] * start.size, options={"maxiter": _GREY_STEPS, "maxcor": 20},
    )  # fmt: skip
    return np.asarray(result.x).reshape(start.shape)


def _thresholded(misfit: GridMisfit, grey: NDArray) -> NDArray:
    thresholds = np.sort(grey.ravel())[::-1][_FEWEST_OPEN - 1 :]
    grids = [(grey >= threshold).astype(np.float64) for threshold in np.unique(thresholds)]
    return min(grids, key=misfit.of_grid)


def improved(
    misfit: GridMisfit, grid: NDArray[np.float64], random: np.random.Generator
) -> BinaryGrid:
    """Improve a binary grid by opening and closing single cells."""
    cells = grid.copy()
    best = BinaryGrid(cells.copy(), misfit.of_grid(cells))
    resting = np.zeros(cells.size, int)
    last = 0
    for step in range(_FLIPS):
        misfits = misfit.of_flips(cells)
        allowed = np.isfinite(misfits) & ((resting <= step) | (misfits < best.misfit))
        if not allowed.any() or step - last > _PATIENCE:
            break
        cell = int(np.where(allowed, misfits, np.inf).argmin())
        cells.flat[cell] = 1 - cells.flat[cell]
        resting[cell] = step + _REST + random.integers(_REST_SPREAD)
        if misfits[cell] < best.misfit:
            best = BinaryGrid(cells.copy(), float(misfits[cell]))
            last = step
    return best
