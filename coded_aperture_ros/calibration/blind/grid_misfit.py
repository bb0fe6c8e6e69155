"""Misfit of grids of cells to the spectra of planes, as a quadratic function.

A spectrum is linear in the autocorrelation of the mask's grid. Near the spectra that were found
the likelihood is quadratic in them, and what smooth textures and noise can compensate is projected
out. The result is a small matrix, with which a million grids can be tried.

Grids are sought grey first, from random starts: these are easy to improve. The threshold is the one
that explains the spectra best; then single cells are opened and closed, also where it gets worse
for a while (tabu search).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.mask.cells import autocorrelation
from coded_aperture_ros.calibration.mask.fit import MaskFit
from coded_aperture_ros.calibration.mask.likelihood import Groups, MaskLikelihood
from coded_aperture_ros.calibration.mask.spectra import half_plane
from coded_aperture_ros.core.arrays import DoubleArray

_MIN_EIGENVALUE = 1e-9
_GREY_STEPS = 150
_FLIPS = 200
_PATIENCE = 40
# A cell that was changed stays for so many steps (tabu search).
_TABU_STEPS = 8
_TABU_SPREAD = 6
_MIN_OPEN_CELLS = 2


@dataclasses.dataclass(frozen=True, eq=False)
class FoundSpectra:
    """Spectra of a fit, around which the likelihood is expanded.

    Power of the blurred texture (`signal` [G, K]) and variance of its noise [G, 1], by group.
    """

    groups: Groups
    signal: DoubleArray
    noise: DoubleArray

    @classmethod
    def from_fit(cls, fit: MaskFit, likelihood: MaskLikelihood) -> "FoundSpectra":
        """Spectra of a fit, with the textures that suit it best."""
        groups = likelihood.group(fit.parts, fit.sizes_px, fit.log_noise)
        power = likelihood.spectra.expected(fit.parts, fit.sizes_px).power
        signal = np.exp(groups.textures @ likelihood.texture) * power[groups.slope, groups.plane]
        return cls(groups, signal, np.exp(fit.log_noise)[groups.plane, None])


class GridMisfit:
    """Misfit of square grids of n x n cells, for given widths of a cell at each plane.

    It is about twice the negative log-likelihood of one window of each group.
    """

    def __init__(
        self, likelihood: MaskLikelihood, found: FoundSpectra, cells: int, cells_px: NDArray
    ) -> None:
        self.cells = cells
        self.lags = half_plane(cells - 1)
        self._add_up(likelihood, found, cells_px)
        # Where the grid lies among closed cells, and what lies at each lag of every cell.
        self._width = 3 * cells - 2
        row, column = (axis.ravel()[:, None] + cells - 1 for axis in np.mgrid[:cells, :cells])
        down, across = self.lags.T
        self._ahead = (row + down) * self._width + column + across
        self._behind = (row - down) * self._width + column - across
        self._at_zero = int(np.flatnonzero(~self.lags.any(axis=1))[0])

    def _add_up(self, likelihood: MaskLikelihood, found: FoundSpectra, cells_px: NDArray) -> None:
        groups = found.groups
        trust = np.sqrt(likelihood.multiplicity) / (found.signal + found.noise)
        gain = trust * np.exp(groups.textures @ likelihood.texture)
        signal = trust * found.signal
        data = trust * (groups.mean - found.noise)
        hessian = np.zeros((len(self.lags), len(self.lags)))
        slope = np.zeros(len(self.lags))
        light = np.zeros(len(self.lags))
        for plane, cell_px in enumerate(cells_px):
            stretched = self._stretched(likelihood, float(cell_px))
            for texture in np.unique(groups.slope[groups.plane == plane]):
                by_lag = likelihood.spectra.operators[texture] @ stretched
                members = np.flatnonzero((groups.plane == plane) & (groups.slope == texture))
                rows = by_lag * np.sqrt(np.sum(gain[members] ** 2, axis=0))[:, None]
                hessian += rows.T @ rows
                for group in members:
                    free = np.column_stack([(signal[group] * likelihood.texture).T, trust[group]])
                    basis, _ = np.linalg.qr(free)
                    light += (signal[group] * gain[group]) @ by_lag
                    made_up = (basis.T * gain[group]) @ by_lag
                    hessian -= made_up.T @ made_up
                    rest = data[group] - basis @ (basis.T @ data[group])
                    slope += (gain[group] * rest) @ by_lag
        # The mask's light is that of the spectra found.
        self._light = light / np.sum(signal**2)
        values, vectors = np.linalg.eigh(hessian)
        kept = values > _MIN_EIGENVALUE * values.max()
        roots = np.sqrt(values[kept])
        self._root = (vectors[:, kept] * roots).T
        self._target = vectors[:, kept].T @ slope / roots

    def _stretched(self, likelihood: MaskLikelihood, cell_px: float) -> NDArray:
        """Autocorrelation in pixels of each lag of the grid [pixel lags, lags]."""
        reach = likelihood.spectra.width - 1
        kernel = _square_overlap(
            np.arange(-reach, reach + 1)[:, None] - np.arange(1 - self.cells, self.cells) * cell_px,
            cell_px,
        )
        vertical, horizontal = likelihood.spectra.lags.T + reach
        down, across = self.lags.T
        middle = self.cells - 1

        def at(sign: int) -> DoubleArray:
            rows = kernel[:, middle + sign * down][vertical]
            columns = kernel[:, middle + sign * across][horizontal]
            return np.asarray(rows * columns)

        return np.where(self.lags.any(axis=1), at(1) + at(-1), at(1))

    def autocorrelation(self, grid: NDArray) -> DoubleArray:
        """Autocorrelation of a grid [n, n] at `lags`."""
        return autocorrelation(grid[None])[self.lags[:, 0], self.lags[:, 1]]

    def misfit(self, autocorrelation: NDArray) -> DoubleArray:
        """Misfit of autocorrelations [..., lags] of any scale."""
        light = autocorrelation @ self._light
        error = (autocorrelation / light[..., None]) @ self._root.T - self._target
        return np.asarray(np.sum(error**2, axis=-1))

    def value(self, grid: NDArray) -> float:
        """Misfit of a grid [n, n]."""
        return float(self.misfit(self.autocorrelation(grid)))

    def flip_values(self, grid: NDArray) -> DoubleArray:
        """Misfit of a binary grid with each of its cells changed [n * n].

        Not finite where no cell would be open.
        """
        change = 1.0 - 2.0 * np.asarray(grid, np.float64).ravel()
        changes = change[:, None] * self._neighbours(grid)
        changes[:, self._at_zero] = change
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.misfit(self.autocorrelation(grid) + changes)

    def value_and_gradient(self, x: DoubleArray) -> tuple[float, DoubleArray]:
        """Misfit of a grid of any transmissions, flat, and its gradient."""
        neighbours = self._neighbours(x.reshape(self.cells, self.cells))
        autocorrelation = x @ neighbours / 2
        light = autocorrelation @ self._light
        error = self._root @ (autocorrelation / light) - self._target
        by_scaled = 2 * error @ self._root
        by_lag = by_scaled / light - self._light * (by_scaled @ autocorrelation) / light**2
        return float(error @ error), neighbours @ by_lag

    def _neighbours(self, grid: NDArray) -> NDArray:
        """Sum of the two cells at each lag from every cell [n * n, lags]."""
        n = self.cells
        padded = np.zeros((self._width, self._width))
        padded[n - 1 : 2 * n - 1, n - 1 : 2 * n - 1] = grid
        return np.asarray(padded.ravel()[self._ahead] + padded.ravel()[self._behind])


def _square_overlap(lag: NDArray, cell_px: float) -> NDArray:
    """Autocorrelation of a cell, integrated over pixels, along one axis; unit sum."""
    total = np.zeros_like(lag)
    for pixel, one in ((-1, 1), (0, -2), (1, 1)):
        for cell, other in ((-1, 1), (0, -2), (1, 1)):
            total += one * other * np.maximum(lag + pixel + cell * cell_px, 0) ** 3 / 6
    return np.asarray(total / cell_px**2)


@dataclasses.dataclass(frozen=True, eq=False)
class BinaryGrid:
    """Open (1) and closed (0) cells [n, n], and their misfit."""

    cells: DoubleArray
    misfit: float


def best_grid(
    misfit: GridMisfit, starts: int, random: np.random.Generator, grids: Sequence[DoubleArray] = ()
) -> BinaryGrid:
    """Best grid from random starts and from binary grids."""
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
    thresholds = np.sort(grey.ravel())[::-1][_MIN_OPEN_CELLS - 1 :]
    grids = [(grey >= threshold).astype(np.float64) for threshold in np.unique(thresholds)]
    return min(grids, key=misfit.value)


def improved(misfit: GridMisfit, grid: DoubleArray, random: np.random.Generator) -> BinaryGrid:
    """Binary grid after opening and closing single cells."""
    cells = grid.copy()
    best = BinaryGrid(cells.copy(), misfit.value(cells))
    resting = np.zeros(cells.size, int)
    last = 0
    for step in range(_FLIPS):
        misfits = misfit.flip_values(cells)
        allowed = np.isfinite(misfits) & ((resting <= step) | (misfits < best.misfit))
        if not allowed.any() or step - last > _PATIENCE:
            break
        cell = int(np.where(allowed, misfits, np.inf).argmin())
        cells.flat[cell] = 1 - cells.flat[cell]
        resting[cell] = step + _TABU_STEPS + random.integers(_TABU_SPREAD)
        if misfits[cell] < best.misfit:
            best = BinaryGrid(cells.copy(), float(misfits[cell]))
            last = step
    return best
