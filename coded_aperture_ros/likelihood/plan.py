"""What a filter bank means for frames of one size: constant matrices that every backend shares.

The power of a patch at frequency ``(v, h)`` is ``|sum_y w_y e^(-ivy) sum_x w_x e^(-ihx) g_yx|^2``
with the Hann window ``w``. The sum over ``x`` is done once for every pixel row: patches above each
other share it. With its cosine and sine parts ``c`` and ``s`` and those of the sum over ``y``, the
powers of ``+v`` and ``-v`` are ``q -+ 2 x`` with::

    q = cc^2 + cs^2 + sc^2 + ss^2        x = cc ss - cs sc

and because a patch enters its energies only through linear functions of the powers (the bank's
common basis), these act on ``q`` and ``x`` directly.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import (
    BoolArray,
    DoubleArray,
    FloatArray,
    IndexArray,
    PerPatch,
    as_floats,
)
from coded_aperture_ros.frames import PatchGrid
from coded_aperture_ros.likelihood.scoring import OWN_NOISE, plausible_ratios

# What is smaller than this share of the largest is rounding.
_NEGLIGIBLE = 1e-6


class Filters(Protocol):
    """What a plan needs of a filter bank; see `FilterBank`."""

    @property
    def window_px(self) -> int:
        """Side of the patches."""

    @property
    def ratios(self) -> DoubleArray:
        """Contrast over noise variance [S]."""

    @property
    def coefficients(self) -> FloatArray:
        """Weights in the common basis [R, S, slopes, L]."""

    @property
    def log_determinants(self) -> FloatArray:
        """Of every hypothesis [S, slopes, L]."""

    @property
    def window(self) -> FloatArray:
        """The window that patches are multiplied by [N]."""

    @property
    def functions_of_power(self) -> FloatArray:
        """Basis and multiplicity [K, R + 1]."""

    @property
    def contrasts(self) -> Sequence[float]:
        """The variances of texture that are tried."""

    @property
    def field(self) -> "PartFilters | None":
        """Of the parts of an image, where they differ."""


class PartFilters(Protocol):
    """What a plan needs of filters that differ from part to part of an image."""

    @property
    def coefficients(self) -> FloatArray:
        """As those of `Filters`, of every part [G, R, S, slopes, L]."""

    @property
    def log_determinants(self) -> FloatArray:
        """As those of `Filters`, of every part [G, S, slopes, L]."""

    def part_of(self, grid: PatchGrid, shape: tuple[int, ...]) -> IndexArray:
        """Return which part every patch is in [rows, columns]; the parts are rectangles."""


@dataclasses.dataclass(frozen=True, eq=False)
class Area:
    """Patches that share their hypotheses."""

    hypotheses: FloatArray  # as those of `Plan`
    rows: slice
    columns: slice


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """Matrices of the transforms, the common basis and the hypotheses."""

    grid: PatchGrid  # where the patches lie, ``rows`` by ``columns``
    horizontal: FloatArray  # [2 H, N]; windowed cosines, then sines, of 0 to H - 1 cycles
    # [2 V + U, N]; windowed cosines, then sines, of 1 to V cycles; then the U cosines without a
    # sine.
    vertical: FloatArray
    paired: int  # V
    # [R + 1, (2 V + U) H]; the common basis and the multiplicity, as functions of ``q`` of 1 to V
    # cycles, of ``x`` of these, and of the power of those without a sine.
    features: FloatArray
    # [2 V + U]; of 0 to H - 1 cycles, how many the features look at: nothing above the highest
    # frequency, nor any ``x`` behind masks that are their own mirror image.
    used: IndexArray
    # [S * slopes * L, R + 1]; weights of every hypothesis in the common basis, and `OWN_NOISE`,
    # which adds to them, all times ``exp(log_determinant / sum m)``: so the best hypothesis is that
    # of the least product, and one logarithm does for all.
    hypotheses: FloatArray
    count: float  # ``sum m``
    levels: int  # L
    ratios: DoubleArray  # [S]; contrast over noise variance of the hypotheses
    contrasts: Sequence[float]  # the variances of texture that are tried under any noise
    areas: tuple[Area, ...]  # all patches; one area unless filters differ over the image

    @classmethod
    def of(cls, bank: Filters, shape: tuple[int, ...], stride_px: int) -> "Plan":
        """Plan for frames of `shape` (rows, columns) with patches every `stride_px`.

        Raises `InputError` if the frame is smaller than a patch.
        """
        grid = PatchGrid.covering(shape, bank.window_px, stride_px)
        n, half = bank.window_px, bank.window_px // 2
        functions = bank.functions_of_power.astype(np.float64)  # [K, R + 1]
        counts = functions.any(axis=1).reshape(n, half + 1)
        # Only up to the highest frequency that counts.
        columns = int(np.flatnonzero(counts.any(axis=0)).max()) + 1
        highest = int(np.flatnonzero(counts[: half + 1].any(axis=1)).max())
        paired = min(highest, half - 1)
        unpaired = [0] if highest < half else [0, half]

        angle = 2 * np.pi / n * np.outer(np.arange(half + 1), np.arange(n))
        cosines, sines = np.cos(angle) * bank.window, np.sin(angle) * bank.window
        pairs = slice(1, paired + 1)

        features = _of_products(functions, n, columns, paired, unpaired)
        sizes = np.abs(features).max(axis=1).reshape(-1, columns)
        looked_at = sizes > _NEGLIGIBLE * sizes.max()
        used = (looked_at * np.arange(1, columns + 1)).max(axis=1)

        count = float(functions[:, -1].sum())
        hypotheses = _hypotheses(bank.coefficients, bank.log_determinants, count)
        areas = [Area(hypotheses, slice(0, grid.rows), slice(0, grid.columns))]
        if bank.field is not None:
            of_parts = zip(bank.field.coefficients, bank.field.log_determinants, strict=True)
            areas = [
                Area(_hypotheses(*of_part, count), *_bounds(place))
                for part, of_part in enumerate(of_parts)
                if (place := bank.field.part_of(grid, shape) == part).any()
            ]
        return cls(
            grid=grid,
            horizontal=as_floats(np.concatenate([cosines[:columns], sines[:columns]])),
            vertical=as_floats(np.concatenate([cosines[pairs], sines[pairs], cosines[unpaired]])),
            paired=paired,
            features=as_floats(features.T),
            used=used,
            hypotheses=hypotheses,
            count=count,
            levels=int(bank.log_determinants.shape[-1]),
            ratios=bank.ratios,
            contrasts=bank.contrasts,
            areas=tuple(areas),
        )

    def with_all_products(self) -> "Plan":
        """Return the plan with every product `used`, for those who look at them, too."""
        all_of_them = np.full_like(self.used, len(self.horizontal) // 2)
        return dataclasses.replace(self, used=all_of_them)

    def tried(self, noise: PerPatch) -> slice:
        """Return which ratios are tried under a noise of this standard deviation."""
        return plausible_ratios(self.ratios, self.contrasts, float(np.median(noise)))

    def hypotheses_of(self, ratios: slice) -> slice:
        """Return which hypotheses belong to some ratios."""
        each = len(self.hypotheses) // len(self.ratios)
        return slice(ratios.start * each, ratios.stop * each)

    def of_products(self, functions: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return linear functions of power [K, n] as functions of the products of transforms.

        From the order of ``scipy.fft.rfft2`` to ``q`` and ``x`` [(2 V + U) H, n]; see `features`.
        """
        columns, half = len(self.horizontal) // 2, self.grid.window_px // 2
        unpaired = [0, half][: len(self.vertical) - 2 * self.paired]
        return _of_products(functions, self.grid.window_px, columns, self.paired, unpaired)

    def shares(self, most: int) -> Iterator[tuple[FloatArray, slice | IndexArray]]:
        """Yield hypotheses and the patches that they are tried on, so many at most."""
        index = np.arange(self.grid.rows * self.grid.columns).reshape(self.grid.rows, -1)
        for area in self.areas:
            patches = index[area.rows, area.columns].ravel()
            for start in range(0, len(patches), most):
                some = patches[start : start + most]
                whole = len(self.areas) == 1  # a slice is not copied
                yield area.hypotheses, slice(some[0], some[-1] + 1) if whole else some

    @property
    def pixel_rows(self) -> int:
        """How many rows of pixels the patches cover."""
        return (self.grid.rows - 1) * self.grid.stride_px + self.grid.window_px

    def covered(self, grey: FloatArray) -> FloatArray:
        """Return the part of a frame that the patches cover, as a view."""
        grid = self.grid
        width = (grid.columns - 1) * grid.stride_px + grid.window_px
        return grey[grid.top : grid.top + self.pixel_rows, grid.left : grid.left + width]


def _hypotheses(coefficients: FloatArray, determinants: FloatArray, count: float) -> FloatArray:
    gains = np.exp(determinants.astype(np.float64).reshape(-1, 1) / count)
    weights = coefficients.reshape(len(coefficients), -1).T
    return as_floats(np.hstack([weights, np.full_like(gains, OWN_NOISE)]) * gains)


def _bounds(place: BoolArray) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(place.any(axis=1)), np.flatnonzero(place.any(axis=0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _of_products(
    functions: NDArray[np.floating], window_px: int, columns: int, paired: int, unpaired: list[int]
) -> NDArray[np.floating]:
    count = functions.shape[1]
    functions = functions.reshape(window_px, window_px // 2 + 1, count)[:, :columns]
    positive = functions[1 : paired + 1]
    negative = functions[: -paired - 1 : -1]
    parts = [positive + negative, 2 * (negative - positive), functions[unpaired]]
    return np.concatenate(parts).reshape(-1, count)
