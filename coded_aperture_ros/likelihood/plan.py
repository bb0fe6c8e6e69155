"""Constant matrices of a filter bank for frames of one size, which all engines share.

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
from coded_aperture_ros.likelihood.scoring import MIN_NOISE_SHARE, plausible_ratios

# Weights below this share of the largest are rounding.
_NEGLIGIBLE = 1e-6
# Distance of the patches with levels that are not dense, px.
_SPARSE_PX = 16


class Filters(Protocol):
    """Part of a filter bank that a plan is made of; see `FilterBank`."""

    @property
    def window_px(self) -> int:
        """Side of the patches."""

    @property
    def ratios(self) -> DoubleArray:
        """Contrast over noise variance [S]."""

    @property
    def coefficients(self) -> FloatArray:
        """Weights of the hypotheses in the common basis [R, S, slopes, L]."""

    @property
    def log_determinants(self) -> FloatArray:
        """Log-determinant of every hypothesis [S, slopes, L]."""

    @property
    def window(self) -> FloatArray:
        """Window of the patches along one side [N]."""

    @property
    def functions_of_power(self) -> FloatArray:
        """Basis and multiplicity [K, R + 1]."""

    @property
    def contrasts(self) -> Sequence[float]:
        """Variances of texture."""

    @property
    def field(self) -> "PartFilters | None":
        """Filters of the parts of an image; None where all parts share them."""


class PartFilters(Protocol):
    """Filters that differ from part to part of an image; see `FieldFilters`."""

    @property
    def coefficients(self) -> FloatArray:
        """Weights of every part's hypotheses [G, R, S, slopes, L]."""

    @property
    def log_determinants(self) -> FloatArray:
        """Log-determinants of every part's hypotheses [G, S, slopes, L]."""

    def part_index(self, grid: PatchGrid, shape: tuple[int, ...]) -> IndexArray:
        """Index of the part of every patch [rows, columns]; the parts are rectangles."""


@dataclasses.dataclass(frozen=True, eq=False)
class Area:
    """Patches that share their hypotheses."""

    hypotheses: FloatArray  # as those of `Plan`
    rows: slice
    columns: slice

    @property
    def size(self) -> int:
        """Numbers R + 1 of a hypothesis."""
        return self.hypotheses.shape[1]


@dataclasses.dataclass(frozen=True, eq=False)
class PatchGroup:
    """Patches, and some levels that are compared on them."""

    hypotheses: FloatArray  # [S, slopes, levels, R + 1]; as those of `Plan`
    levels: slice
    indices: slice | IndexArray  # of the patches, row by row


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """Matrices of the transforms, the common basis and the hypotheses.

    Examples
    --------
    >>> from coded_aperture_ros.likelihood.bank import learn_bank
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> bank = learn_bank(render_psf_stack(Mask.named("disc"), [3.0, 5.0, 7.0]))
    >>> plan = Plan.for_frames(bank, (120, 160), stride_px=8)
    >>> plan.levels, plan.grid.rows, plan.grid.columns
    (3, 10, 15)
    """

    grid: PatchGrid
    horizontal: FloatArray  # [2 H, N]; windowed cosines, then sines, of 0 to H - 1 cycles
    # [2 V + U, N]; windowed cosines, then sines, of 1 to V cycles; then the U cosines without a
    # sine.
    vertical: FloatArray
    paired: int  # V
    # [R + 1, (2 V + U) H]; the common basis and the multiplicity, as functions of ``q`` of 1 to V
    # cycles, of ``x`` of these, and of the power of those without a sine.
    features: FloatArray
    # [2 V + U]; number of horizontal frequencies, from 0 on, with a weight in the features: none
    # above the highest frequency, and no ``x`` behind masks that are their own mirror image.
    horizontal_counts: IndexArray
    # [S * slopes * L, R + 1]; weights of every hypothesis in the common basis, and the constant
    # `MIN_NOISE_SHARE`, all times ``exp(log_determinant / sum m)``: so the best hypothesis is that
    # of the least product, and one logarithm does for all.
    hypotheses: FloatArray
    count: float  # ``sum m``
    levels: int  # L
    dense_levels: int  # those after them are of interest at every `sparse_step`-th patch only
    ratios: DoubleArray  # [S]; contrast over noise variance of the hypotheses
    contrasts: Sequence[float]  # variances of texture, the same under any noise
    areas: tuple[Area, ...]  # all patches; one area unless filters differ over the image

    @classmethod
    def for_frames(
        cls, bank: Filters, shape: tuple[int, ...], stride_px: int, dense_levels: int | None = None
    ) -> "Plan":
        """Plan for frames of `shape` (rows, columns) with patches every `stride_px`.

        Without `dense_levels` all levels are.

        Raises
        ------
        InputError
            If the frame is smaller than a patch.
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

        features = functions_of_products(functions, n, columns, paired, unpaired)
        sizes = np.abs(features).max(axis=1).reshape(-1, columns)
        has_weight = sizes > _NEGLIGIBLE * sizes.max()
        horizontal_counts = (has_weight * np.arange(1, columns + 1)).max(axis=1)

        count = float(functions[:, -1].sum())
        hypotheses = _hypotheses(bank.coefficients, bank.log_determinants, count)
        areas = [Area(hypotheses, slice(0, grid.rows), slice(0, grid.columns))]
        if bank.field is not None:
            filters = zip(bank.field.coefficients, bank.field.log_determinants, strict=True)
            areas = [
                Area(_hypotheses(*filters_of_part, count), *_bounds(inside))
                for part, filters_of_part in enumerate(filters)
                if (inside := bank.field.part_index(grid, shape) == part).any()
            ]
        return cls(
            grid=grid,
            horizontal=as_floats(np.concatenate([cosines[:columns], sines[:columns]])),
            vertical=as_floats(np.concatenate([cosines[pairs], sines[pairs], cosines[unpaired]])),
            paired=paired,
            features=as_floats(features.T),
            horizontal_counts=horizontal_counts,
            hypotheses=hypotheses,
            count=count,
            levels=int(bank.log_determinants.shape[-1]),
            dense_levels=dense_levels or int(bank.log_determinants.shape[-1]),
            ratios=bank.ratios,
            contrasts=bank.contrasts,
            areas=tuple(areas),
        )

    def plausible_ratios(self, noise: PerPatch) -> slice:
        """Slice of the ratios that are compared under a noise (standard deviation)."""
        return plausible_ratios(self.ratios, self.contrasts, float(np.median(noise)))

    def hypothesis_rows(self, ratios: slice) -> slice:
        """Slice of the hypotheses that belong to a slice of the ratios."""
        each = len(self.hypotheses) // len(self.ratios)
        return slice(ratios.start * each, ratios.stop * each)

    @property
    def sparse_step(self) -> int:
        """Of so many patches, along rows and columns, one has the levels that are not dense."""
        return max(_SPARSE_PX // self.grid.stride_px, 1)

    def patch_groups(self, size: int) -> Iterator["PatchGroup"]:
        """Groups of at most `size` patches that share their hypotheses."""
        index = np.arange(self.grid.rows * self.grid.columns).reshape(self.grid.rows, -1)
        step = self.sparse_step
        sparse = np.zeros(index.shape, np.bool_)
        sparse[::step, ::step] = True
        dense = slice(0, self.dense_levels), slice(self.dense_levels, self.levels)
        for area in self.areas:
            hypotheses = area.hypotheses.reshape(len(self.ratios), -1, self.levels, area.size)
            here = np.s_[area.rows, area.columns]
            patches = index[here].ravel(), index[here][sparse[here]]
            for levels, some in zip(dense, patches, strict=True):
                own = np.ascontiguousarray(hypotheses[:, :, levels])
                for start in range(0, len(some) if own.size else 0, size):
                    group = some[start : start + size]
                    contiguous = len(group) == group[-1] + 1 - group[0]  # a slice is not copied
                    indices = slice(group[0], group[-1] + 1) if contiguous else group
                    yield PatchGroup(own, levels, indices)

    @property
    def pixel_rows(self) -> int:
        """Number of rows of pixels that the patches cover."""
        return (self.grid.rows - 1) * self.grid.stride_px + self.grid.window_px

    def crop(self, grey: FloatArray) -> FloatArray:
        """View of the part of a frame that the patches cover."""
        grid = self.grid
        width = (grid.columns - 1) * grid.stride_px + grid.window_px
        return grey[grid.top : grid.top + self.pixel_rows, grid.left : grid.left + width]


def _hypotheses(coefficients: FloatArray, determinants: FloatArray, count: float) -> FloatArray:
    """Rows of `Plan.hypotheses`."""
    gains = np.exp(determinants.astype(np.float64).reshape(-1, 1) / count)
    weights = coefficients.reshape(len(coefficients), -1).T
    return as_floats(np.hstack([weights, np.full_like(gains, MIN_NOISE_SHARE)]) * gains)


def _bounds(inside: BoolArray) -> tuple[slice, slice]:
    """Rows and columns of the rectangle where a mask is True."""
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def functions_of_products(
    functions: NDArray[np.floating], window_px: int, columns: int, paired: int, unpaired: list[int]
) -> NDArray[np.floating]:
    """Linear functions of power [K, n] as those of the products; see `Plan.features`."""
    count = functions.shape[1]
    functions = functions.reshape(window_px, window_px // 2 + 1, count)[:, :columns]
    positive = functions[1 : paired + 1]
    negative = functions[: -paired - 1 : -1]
    parts = [positive + negative, 2 * (negative - positive), functions[unpaired]]
    return np.concatenate(parts).reshape(-1, count)
