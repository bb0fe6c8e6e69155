"""Mask of a camera from pictures of planes at unknown distances (thesis 10.2).

1. Spectra are matched with one another: the blur sizes but for a common factor.
2. A mixture of masks, whose autocorrelation is easy to optimise to, is fitted together with the
   sizes; where it ends is the largest blur in pixels.
3. Grids of cells of all widths are tried: the binary one that explains the spectra best is the
   mask.

A power spectrum has no phases, so that a mask and the same mask turned by 180 degrees cannot be
told apart.
"""

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.blind.config import BlindConfig
from coded_aperture_ros.calibration.blind.grid_misfit import (
    BinaryGrid,
    FoundSpectra,
    GridMisfit,
    best_grid,
)
from coded_aperture_ros.calibration.blind.relative_sizes import relative_blur_sizes
from coded_aperture_ros.calibration.mask.cells import autocorrelation
from coded_aperture_ros.calibration.mask.fit import MaskFit, normalised, random_parts
from coded_aperture_ros.calibration.mask.likelihood import MaskLikelihood
from coded_aperture_ros.calibration.mask.sizes import FreeSizes
from coded_aperture_ros.calibration.mask.spectra import mean_by_contrast, window_powers
from coded_aperture_ros.calibration.planes.checks import check_pictures
from coded_aperture_ros.calibration.planes.pictures import check_picture
from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.frames import channel_mean
from coded_aperture_ros.likelihood.bank import WindowedFourierBasis
from coded_aperture_ros.optics import Mask

FreeFit = MaskFit[FreeSizes]

_MIN_PLANES = 4
_HIGHEST_FREQUENCY = 0.4
_COARSE_PARTS = 2
_FINE_PARTS = 3
_COARSE_CELLS = 16
_FINE_CELLS = 24
_COARSE_STEPS = 60
_FINE_STEPS = 200
_SIZE_STEPS = 60
# The mixture's autocorrelation, relative to its middle, where the mask ends.
_EDGE_CORRELATION = 0.015
# A grid of the mixture much wider than the mask wastes its cells.
_MIN_EXTENT_SHARE = 0.75
_MARGIN = 1.08
_GRID_MARGIN = 1.1
# The mixture's light ends within this factor of the mask's.
_EXTENT_FACTOR = 1.09
# Widths of a grid to try are so many cells apart; the best numbers of cells are refined.
_CELL_STEP = 0.35
_PROMISING = 5
# Gain that a further cell needs: to be open or closed is one bit.
_COST_PER_CELL = 2 * np.log(2)
_ROUNDS = 2
_FLIPS = 12
_LIKELY_FLIPS = 12
_MIN_EXPLAINED = 0.25
# A mixture explains spectra a little better than the right mask, and much better than a wrong one.
# Twice the negative log-likelihood per coefficient: 0.007 to 0.016 for masks that were found, 0.036
# for one with a wrong cell, 0.042 for another mask.
_MAX_MIXTURE_GAIN = 0.025


@dataclasses.dataclass(frozen=True, eq=False)
class BlindMask:
    """Mask found from planes at unknown distances."""

    # Binary, cropped to where it is open. As found, or turned by 180 degrees: spectra do not tell.
    mask: Mask
    blur_sizes_px: DoubleArray  # [planes]; width of the mask's extent in each picture, unsigned
    # Share of the structure of the spectra that the mask explains, 0 to 1; an open square
    # explains nothing.
    explained: float
    # [planes, 2, n, n // 2 + 1]; logarithm of the power of each picture's windows, as it is and as
    # the mask explains it, at the frequencies of ``rfft2``; NaN at those that were not looked at.
    spectra: DoubleArray
    # Whether a picture is blurred by more than the largest blur; its size is uncertain then.
    reaches_limit: bool
    # Whether a mixture of masks explains the spectra so much better that this may not be the mask.
    doubtful: bool = False


def find_mask(
    images: Sequence[FloatArray],
    names: Sequence[str],
    config: BlindConfig | None = None,
    progress: Progress = iter,
) -> BlindMask:
    """Mask and blur sizes from pictures of textured planes at unknown distances.

    Parameters
    ----------
    images : sequence of ndarray, float32 [rows, columns] or [rows, columns, 3]
        Linear light, all of one camera and setting, each of a plane parallel to the sensor, all on
        one side of the focus, in any order. The textures need not be the same.
    names : sequence of str
        Names of the pictures for messages.
    config : BlindConfig, optional
    progress : callable, optional
        Wraps the iteration over the steps, as ``tqdm.tqdm`` does.

    Returns
    -------
    BlindMask

    Raises
    ------
    InputError
        If there are fewer than four planes, one cannot be used (size, light, texture), all are
        blurred alike, or their spectra show no mask.

    References
    ----------
    Martinello 2012, section 10.2.
    """
    config = config or BlindConfig()
    greys = _checked(images, names, config)
    sizes = relative_blur_sizes(greys, names, 2 * config.window_px)
    return _Search(greys, config, progress).run(sizes)


def _checked(
    images: Sequence[FloatArray], names: Sequence[str], config: BlindConfig
) -> list[FloatArray]:
    """Grey pictures; raises `InputError` if one cannot be used."""
    if len(images) < _MIN_PLANES:
        raise InputError(
            f"{len(images)} planes are too few to tell the mask from the textures: take at least "
            f"{_MIN_PLANES}, better 8 or more, at different distances"
        )
    for image, name in zip(images, names, strict=True):
        check_picture(image, name, images[0].shape[:2], names[0])
    least = 2 * config.window_px
    if min(images[0].shape[:2]) < least:
        raise InputError(
            f"{names[0]}: {images[0].shape[1]}x{images[0].shape[0]} px are too few for blur of up "
            f"to {config.largest_blur_px} px: {least} px each way are needed, or a smaller "
            "largest_blur_px"
        )
    check_pictures(images, names, config.window_px)
    return [channel_mean(image) for image in images]


class _Search:
    """Steps of `find_mask` after the relative sizes."""

    def __init__(self, images: list[FloatArray], config: BlindConfig, progress: Progress) -> None:
        fourier = WindowedFourierBasis(config.window_px, _HIGHEST_FREQUENCY)
        means = [mean_by_contrast(window_powers(image, fourier), fourier) for image in images]
        self.config = config
        self.fourier = fourier
        self.progress = progress
        self.widest_px = float(config.largest_blur_px)
        # A grid that is a cell too wide still has room.
        self.likelihood = MaskLikelihood(means, fourier, _GRID_MARGIN * self.widest_px)
        self.random = np.random.default_rng(config.seed)

    def run(self, relative_sizes: DoubleArray) -> BlindMask:
        fit = self._mixture(relative_sizes * self.widest_px)
        extent = _extent(fit)
        if extent < _MIN_EXTENT_SHARE:
            fit = self._mixture(fit.sizes_px * min(extent * _MARGIN, 1))
            extent = _extent(fit)
        found = FoundSpectra.from_fit(fit, self.likelihood)
        least = self._value(fit)
        tried = self._tried(fit, found, extent)
        # The quadratic function is right near the mixture only: the likelihood itself decides.
        refined = [self._refined(fit, found, *one) for one in self.progress(tried)]
        fit = min(refined, key=self._penalised_value)
        fit = min([fit, *self._redrawn(fit)], key=self._penalised_value)
        fit = self._flipped(fit, found)
        cells = _cells(fit)
        cropped = cells[_bounds(cells)]
        if cropped.all():
            raise InputError(
                "no mask pattern in the spectra of the planes, only an open rectangle: is "
                "there a mask with a pattern in the lens?"
            )
        explained = self._explained(fit, found)
        if explained < _MIN_EXPLAINED:
            raise InputError(
                "no mask pattern in the spectra of the planes "
                f"({explained:.0%} of their structure explained): is there a mask with a pattern "
                "in the lens, and are all planes on one side of the focus, blurred by 5 px and "
                f"more, and by at most largest_blur_px, {self.config.largest_blur_px} px?"
            )
        coefficients = found.groups.count.sum() * self.likelihood.multiplicity.sum()
        sizes_px = fit.sizes_px * max(cropped.shape) / len(cells)
        return BlindMask(
            mask=Mask("found", cropped.astype(np.float32)),
            blur_sizes_px=sizes_px,
            explained=explained,
            spectra=self._spectra(fit),
            reaches_limit=bool(sizes_px.max() > self.widest_px),
            doubtful=bool(self._value(fit) - least > _MAX_MIXTURE_GAIN * coefficients),
        )

    def _fit(self, parts: NDArray, sizes_px: NDArray, log_noise: NDArray) -> FreeFit:
        return MaskFit(parts, FreeSizes(sizes_px, self.likelihood.widest_px), log_noise)

    def _mixture(self, sizes_px: NDArray) -> FreeFit:
        """Mixture and sizes, coarse masks first."""
        parts = random_parts(_COARSE_PARTS, _COARSE_CELLS)
        fit = self._fit(parts, sizes_px, self.likelihood.first_log_noise)
        cells = min(_FINE_CELLS, int(np.ceil(sizes_px.max())))
        coarse, fine = _COARSE_STEPS // 2, _FINE_STEPS // 2
        for number, steps in self.progress(list(enumerate((coarse, coarse, fine, fine)))):
            if number == 2:
                # Afresh: the coarse ones' cells would stay visible.
                fit = dataclasses.replace(fit, parts=random_parts(_FINE_PARTS, cells))
            fit = fit.optimise(self.likelihood, steps)
        return fit

    def _tried(
        self, fit: FreeFit, found: FoundSpectra, extent: float
    ) -> list[tuple[NDArray, float]]:
        """Best grids, best number of cells first, with widths over the mixture's."""
        best: dict[int, tuple[BinaryGrid, float]] = {}
        candidates = [(n, float(width)) for n in self._counts for width in _widths(extent, n)]
        for count, width in self.progress(candidates):
            misfit = GridMisfit(self.likelihood, found, count, fit.sizes_px * width / count)
            grid = best_grid(misfit, self.config.starts, self.random)
            if count not in best or grid.misfit < best[count][0].misfit:
                best[count] = grid, width
        ranked = sorted(best.values(), key=lambda one: one[0].misfit + _penalty(one[0].cells))
        return [(grid.cells, width) for grid, width in ranked[:_PROMISING]]

    @property
    def _counts(self) -> range:
        return range(self.config.least_cells, self.config.most_cells + 1)

    def _misfit(self, fit: FreeFit, found: FoundSpectra, cells: int) -> GridMisfit:
        return GridMisfit(self.likelihood, found, cells, fit.sizes_px / cells)

    def _resized(self, fit: FreeFit, cells: NDArray) -> FreeFit:
        """Fit of sizes, textures and noise to a grid."""
        fit = dataclasses.replace(fit, parts=normalised(cells[None]))
        return fit.optimise(self.likelihood, _SIZE_STEPS, masks=False)

    def _refined(
        self, mixture: FreeFit, found: FoundSpectra, cells: NDArray, width: float
    ) -> FreeFit:
        """Fit of sizes and cells in turn, each with the others as found."""
        fit = self._fit(mixture.parts, mixture.sizes_px * width, mixture.log_noise)
        for _ in range(_ROUNDS):
            fit = self._resized(dataclasses.replace(fit, log_noise=mixture.log_noise), cells)
            misfit = self._misfit(fit, found, len(cells))
            cells = best_grid(misfit, 0, self.random, [cells]).cells
        return dataclasses.replace(fit, parts=normalised(cells[None]))

    def _redrawn(self, fit: FreeFit) -> list[FreeFit]:
        """Fits of the mask with every other number of cells, for openings between its own cells."""
        cells = _cells(fit)
        redrawn = []
        for count in self._counts:
            grid = cv2.resize(cells, (count, count), interpolation=cv2.INTER_AREA) > 0.5
            if count != len(cells) and grid.any():
                redrawn.append(self._resized(fit, grid.astype(np.float64)))
        return redrawn

    def _flipped(self, fit: FreeFit, found: FoundSpectra) -> FreeFit:
        """Fit after opening and closing single cells while that is likelier."""
        value = self._value(fit)
        for _ in range(_FLIPS):
            cells = _cells(fit)
            misfits = self._misfit(fit, found, len(cells)).flip_values(cells)
            changed = []
            for cell in sorted({*np.argsort(misfits)[:_LIKELY_FLIPS], *_isolated_cells(cells)}):
                flipped = cells.copy()
                flipped.flat[cell] = 1 - flipped.flat[cell]
                changed.append(dataclasses.replace(fit, parts=normalised(flipped[None])))
            values = [self._value(one) for one in changed]
            if min(values) >= value:
                break
            value = min(values)
            fit = changed[int(np.argmin(values))]
        return fit.optimise(self.likelihood, _SIZE_STEPS, masks=False)

    def _value(self, fit: FreeFit) -> float:
        """Twice the negative log-likelihood of one window of each group."""
        groups = self.likelihood.group(fit.parts, fit.sizes_px, fit.log_noise)
        value, _ = self.likelihood.value_and_gradient(
            fit.parts, fit.sizes_px, groups.textures, fit.log_noise, groups
        )
        return float(value * groups.count.sum() * self.likelihood.multiplicity.sum())

    def _penalised_value(self, fit: FreeFit) -> float:
        return self._value(fit) + _penalty(fit.parts[0])

    def _explained(self, fit: FreeFit, found: FoundSpectra) -> float:
        """Misfit relative to that of an open rectangle of the same extent, subtracted from 1."""
        cells = _cells(fit)
        opened = np.zeros_like(cells)
        opened[_bounds(cells)] = 1
        misfit = self._misfit(fit, found, len(cells))
        return 1 - misfit.value(cells) / misfit.value(opened)

    def _spectra(self, fit: FreeFit) -> NDArray:
        """Measured and explained spectra of the windows of least contrast."""
        found = FoundSpectra.from_fit(fit, self.likelihood)
        _, first = np.unique(found.groups.plane, return_index=True)
        powers = np.stack([found.groups.mean, found.signal + found.noise], axis=1)[first]
        n = self.config.window_px
        spectra = np.full((len(first), 2, n * (n // 2 + 1)), np.nan)
        spectra[..., self.fourier.multiplicity > 0] = np.log(powers)
        return spectra.reshape(len(first), 2, n, -1)


def _cells(fit: FreeFit) -> NDArray:
    """Open (1) and closed (0) cells [n, n] of a binary mask."""
    return (fit.parts[0] > 0).astype(np.float64)


def _widths(extent: float, cells: int) -> NDArray:
    """Widths of grids of cells to try, near that of the mask of the mixture."""
    low = extent / _EXTENT_FACTOR
    high = min(extent * _EXTENT_FACTOR, 1.0)
    count = int(np.ceil(np.log(high / low) * cells / _CELL_STEP)) + 1
    return np.geomspace(low, high, count)


def _penalty(cells: NDArray) -> float:
    """Cost of the choice of the cells in the rectangle around the open ones."""
    return float(_COST_PER_CELL * cells[_bounds(cells)].size)


def _isolated_cells(cells: NDArray) -> IndexArray:
    """Flat indices of cells that differ from all four neighbours."""
    padded = np.pad(cells, 1)
    around = (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:])
    return np.flatnonzero(np.all([other != cells for other in around], axis=0))


def _bounds(cells: NDArray) -> tuple[slice, slice]:
    """Rows and columns between the first and the last with an open cell."""
    rows, columns = (np.flatnonzero(cells.any(axis=axis)) for axis in (1, 0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _extent(fit: FreeFit) -> float:
    """Width of the mask over that of the mixture's grid: where its light ends."""
    cells = fit.parts.shape[-1]
    correlation = autocorrelation(fit.parts)
    profiles = [correlation.max(axis=axis)[:cells] / correlation[0, 0] for axis in (0, 1)]
    return (
        max(int(np.flatnonzero(profile > _EDGE_CORRELATION)[-1]) + 1 for profile in profiles)
        / cells
    )
