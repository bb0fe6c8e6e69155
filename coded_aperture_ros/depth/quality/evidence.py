"""Features of a frame's windows: how well the bank explains them, and other PSFs do."""

import dataclasses
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.core.arrays import (
    BoolArray,
    DoubleArray,
    FloatArray,
    IndexArray,
    constant,
    filters,
    namespace,
    quantiles,
    zeros,
)
from coded_aperture_ros.core.compiled import Compiled
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.quality.spectra import (
    NAMES,
    SLOPES,
    WINDOW_PX,
    PsfHypotheses,
    alternatives,
    bank_levels,
    frequencies,
    levels_beyond,
    negative_log_likelihood,
    power_spectra,
)
from coded_aperture_ros.depth.quality.tally_plain import (
    MAP_COLUMNS,
    MAP_ROWS,
    MAP_STEPS,
    RINGS,
    SECTORS,
    At,
    Sums,
    tally_plain,
)
from coded_aperture_ros.frames.patches import PatchGrid, window_means
from coded_aperture_ros.optics import PsfStack

# Step between possible windows, px; the most textured one of every cell of the frame is chosen.
_STRIDE_PX = 8
FEWEST_WINDOWS = 4
# Side of the box that texture is measured against, px.
_BLUR_PX = 15
# Largest share of unusable pixels in a window.
_UNUSABLE_SHARE = 0.005
# Gains of alternatives, in hundredths of the negative log-likelihood: the least that counts (1 is
# far more than chance for one window), the limits of means and of quantiles, and the value of those
# that were not tried.
_GAIN = 0.3
_MOST_GAIN = 6.0
_EXTREME_GAIN = 10.0
_MISSING_GAIN = -2.0
_LARGEST_RESIDUAL = 12.0
_SIZE_UNIT_PX = 20.0
_BANDS = (0.1, 0.2, 0.3, 0.4)
_DIRECTIONS = 8
_MAP_LEAST = 30


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """Features of a frame's windows, and the blur size of each."""

    features: list[Any]  # numbers for the network
    rows: IndexArray  # [n]; pixels at the windows' centres
    columns: IndexArray
    size_px: DoubleArray  # [n]; blur size of the likeliest level, without sign
    weight: DoubleArray  # [n]; by texture; the sum is 1
    counted: BoolArray  # [n]; on a device there are others, without weight


class HypothesisTest:
    """Likelihood-ratio test of a bank's levels against other PSFs; see `alternatives`.

    With `guarded`, blur sizes beyond the bank's count as its own, as its ends stand for them.
    """

    def __init__(self, stack: PsfStack, guarded: bool = False) -> None:
        own = bank_levels(stack)
        beyond, others = levels_beyond(own), alternatives(own)
        if guarded:
            own = own.with_others(beyond)
        elif beyond.psfs:
            others["beyond"] = PsfHypotheses.from_psfs(beyond.psfs)
        self.levels = own
        self._sizes_px, self._own = own.sizes_px, PsfHypotheses.from_psfs(own.psfs)
        self.others = PsfHypotheses.concatenate(list(others.values()))
        ends = np.cumsum([group.weights.shape[1] for group in others.values()])
        starts = [0, *ends[:-1]]
        self.groups = dict(zip(others, map(slice, starts, ends), strict=True))

    def score(
        self, grey: FloatArray, noise: float, unusable: BoolArray | None, cells: int = 10
    ) -> Evidence | None:
        """Evidence of a frame; None if it has too few textured windows.

        Parameters
        ----------
        grey : ndarray, float32 [height, width]
            Linear light, without NaN.
        noise : float
            Its standard deviation, > 0.
        unusable : ndarray, bool [height, width], or None
            Pixels that were filled in.
        cells : int
            Most windows along each side of the frame.
        """
        tops, lefts, counted = windows_of_cells(grey, unusable, cells)
        if len(tops) < FEWEST_WINDOWS:
            return None
        xp, own = namespace(grey), self._own.like(grey)
        power = power_spectra(cut_windows(grey, tops, lefts)) / noise**2
        scores = negative_log_likelihood(power, own).reshape(len(power), -1)
        best, kinds = scores.argmin(1), own.weights.shape[1]
        contrast, kind = best // kinds, best % kinds
        level, slope = kind // len(SLOPES), kind % len(SLOPES)
        least = xp.amin(scores, 1)
        # Those that do not count must not widen the range.
        lowest = xp.amin(xp.where(counted, contrast, len(own.weights)))
        near = self.others.near_contrasts(lowest, xp.amax(contrast * counted))
        better = self._gains(power, least, near)
        # Residual of the best hypothesis: 1 on the mean, and scattered like the power of noise.
        share = constant(frequencies().share, grey)
        own_noise = xp.exp(least - own.log_determinants[contrast, kind])
        residual = own.weights[contrast, kind] * power
        residual /= share
        residual /= own_noise[:, None]
        scatter = -(xp.log(xp.maximum(residual, 1e-6)) @ share)
        texture, weight = texture_and_weight(power)
        weight *= counted
        weight /= weight.sum()
        sizes_px, logarithm = self._sizes_px, xp.log(own_noise)
        size_px = constant(sizes_px, grey)[level]
        extreme = xp.clip(better, -_EXTREME_GAIN, _EXTREME_GAIN)

        def mean(values: NDArray[Any]) -> Any:
            return weight @ xp.asarray(values, dtype=xp.float32)

        features = [
            *mean(xp.clip(better, -_MOST_GAIN, _MOST_GAIN)),
            *quantiles(extreme, 0.25, 0.5, 0.75, 0.9, where=counted).ravel(),
            *mean(better > _GAIN),
            *mean(better < -_GAIN),
            *mean(xp.clip(-xp.sort(-better, axis=1)[:, :2], -_MOST_GAIN, _MOST_GAIN)),
            mean(scatter),
            *quantiles(scatter, 0.25, 0.75, where=counted),
            mean(logarithm),
            *quantiles(logarithm, 0.25, where=counted),
            (texture * counted).sum() / counted.sum(),
            *quantiles(texture, 0.9, where=counted),
            mean(level == 0),
            mean(level == len(sizes_px) - 1),
            mean(size_px) / _SIZE_UNIT_PX,
            sizes_px.min() / _SIZE_UNIT_PX,
            sizes_px.max() / _SIZE_UNIT_PX,
            mean(slope == 0),
            mean(contrast == len(own.weights) - 1),
            *_residuals(xp.minimum(residual, _LARGEST_RESIDUAL), size_px, weight),
        ]
        half = WINDOW_PX // 2
        return Evidence(features, tops + half, lefts + half, size_px, weight, counted)

    def _gains(self, power: FloatArray, least: FloatArray, near: PsfHypotheses) -> FloatArray:
        """Gain of each alternative over the bank for each window [n, len(NAMES)], hundredths.

        Only contrasts near those that explain the windows best are tried: others take time and
        change nothing.
        """
        xp = namespace(power)
        each = xp.amin(negative_log_likelihood(power, near), 1)
        tried = {
            name: 100 * (least - xp.amin(each[:, group], 1)) for name, group in self.groups.items()
        }
        missing = xp.full_like(least, _MISSING_GAIN)
        return xp.stack([tried.get(name, missing) for name in NAMES], -1)


def texture_and_weight(power: FloatArray) -> tuple[DoubleArray, DoubleArray]:
    """Logarithm of the power over the noise of windows [n, K], and how much each counts; [n]."""
    xp = namespace(power)
    texture = xp.log10(xp.maximum(power @ constant(frequencies().share, power), 1.0))
    return texture, xp.clip(texture - 0.15, 0.02, 1.5)


def windows_of_cells(
    grey: FloatArray, unusable: BoolArray | None, cells: int
) -> tuple[IndexArray, IndexArray, BoolArray]:
    """First row and column of the most textured window of every cell, and which have texture [n].

    Those without are left out, but on a device, which is not waited for.
    """
    try:
        grid = PatchGrid.covering(grey.shape, WINDOW_PX, _STRIDE_PX)
    except InputError:
        return np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0, np.bool_)
    xp, cv, some = namespace(grey), filters(grey), grey[::2]  # is enough for the texture
    fine = cv.absdiff(some, cv.blur(some, (_BLUR_PX, _BLUR_PX // 2)))
    blocks = [max(length // _STRIDE_PX, 1) for length in grey.shape[::-1]]
    mean = cv.blur(cv.resize(fine, blocks, interpolation=cv.INTER_AREA), (3, 3))
    texture = grid.centre_values(mean, _STRIDE_PX)
    if unusable is not None:
        unusable_px = xp.asarray(unusable, dtype=xp.float32)
        share = window_means(unusable_px, grid, WINDOW_PX * 3 // 4)
        texture = xp.where(share > _UNUSABLE_SHARE, -1.0, texture)
    rows, columns = (_cells_of_axis(length, cells) for length in texture.shape)
    of_cells = xp.take(xp.take(texture, rows.ravel(), axis=0), columns.ravel(), axis=1)
    of_cells = of_cells.reshape(*rows.shape, *columns.shape).swapaxes(1, 2)
    of_cells = of_cells.reshape(-1, rows.shape[1] * columns.shape[1])
    best, textured = of_cells.argmax(1), xp.amax(of_cells, 1) > 0
    cell = np.arange(len(rows) * len(columns))
    at_row, at_column = (
        constant(starts, grey) - WINDOW_PX // 2
        for starts in (
            grid.row_centres[rows[cell // len(columns)]],
            grid.column_centres[columns[cell % len(columns)]],
        )
    )
    of_each, width = constant(cell, grey), columns.shape[1]
    tops, lefts = at_row[of_each, best // width], at_column[of_each, best % width]
    if xp is np:
        return tops[textured], lefts[textured], textured[textured]
    return tops, lefts, textured


def _cells_of_axis(length: int, cells: int) -> IndexArray:
    """Indices of every cell along an axis; the last is repeated in shorter cells."""
    groups = np.array_split(np.arange(length), min(cells, length))
    longest = len(groups[0])
    return np.array([np.pad(group, (0, longest - len(group)), "edge") for group in groups])


def cut_windows(grey: FloatArray, tops: IndexArray, lefts: IndexArray) -> FloatArray:
    """Windows of a frame [n, N, N]."""
    if namespace(grey) is np:
        at = zip(tops, lefts, strict=True)
        return np.stack([grey[t : t + WINDOW_PX, x : x + WINDOW_PX] for t, x in at])
    frame: Any = grey
    return frame.unfold(0, WINDOW_PX, 1).unfold(1, WINDOW_PX, 1)[tops, lefts]


def _residuals(residual: FloatArray, size_px: DoubleArray, weight: DoubleArray) -> list[float]:
    """Features of the residual's spectrum.

    By frequency and direction, for motion and processing, and by frequency times blur size, where
    another mask leaves the same pattern at all depths.
    """
    xp, at = namespace(residual), frequencies()
    mean = xp.maximum(weight @ residual, 1e-3)
    bands = constant(_band_cells(), mean)
    band_sums, band_counts = (
        xp.bincount(bands, values, (len(_BANDS) + 1) * _DIRECTIONS) for values in (mean, None)
    )
    of_rings = zeros((2, (RINGS + 1) * SECTORS), size_px)
    of_map = zeros((3, MAP_ROWS * MAP_COLUMNS), size_px)
    arrays = at.radius, at.vertical, at.horizontal, _sectors()
    radius, *others = (constant(each, mean) for each in arrays)
    tally = _tally if xp is np else tally_plain
    tally(residual, size_px, weight, (radius, *others), (of_rings, of_map))
    enough = of_map[2] > xp.minimum(of_map[2].max() - 1, _MAP_LEAST)
    count = enough.sum()
    pattern = xp.log(xp.where(enough, of_map[0], 1) / xp.where(enough, of_map[1], 1))
    rings = of_rings.reshape(2, -1, SECTORS)[:, :RINGS]
    rings = xp.log((rings[0] + 0.002) / (rings[1] + 0.002))
    ring_mean = rings.mean(axis=1)
    return [
        *xp.log(band_sums / band_counts),
        *ring_mean,
        xp.std(rings),
        xp.abs(rings - ring_mean[:, None]).mean(),
        xp.sqrt((pattern**2).sum() / count),
        *quantiles(pattern, 0.05, 0.95, where=enough),
        pattern.sum() / count,
    ]


@lru_cache(maxsize=1)
def _band_cells() -> IndexArray:
    at = frequencies()
    return np.digitize(at.radius, _BANDS) * _DIRECTIONS + at.directions(_DIRECTIONS)


@lru_cache(maxsize=1)
def _sectors() -> IndexArray:
    return frequencies().directions(SECTORS)


def _tally_loop(
    residual: FloatArray, size_px: DoubleArray, weight: DoubleArray, at: At, sums: Sums
) -> None:
    """Add up residuals and weights by ring and sector, and in a map of the PSFs' frequencies."""
    (radius, vertical, horizontal, sector), (of_rings, of_map) = at, sums
    for i in range(len(residual)):
        size = size_px[i]
        for k in range(len(radius)):
            share = weight[i] * residual[i, k]
            cell = min(int(2 * size * radius[k]), RINGS) * SECTORS + sector[k]
            of_rings[0, cell] += share
            of_rings[1, cell] += weight[i]
            column = min(int(size * horizontal[k] * MAP_STEPS), MAP_COLUMNS - 1)
            row = int(size * vertical[k] * MAP_STEPS + MAP_ROWS // 2)
            cell = column * MAP_ROWS + min(max(row, 0), MAP_ROWS - 1)
            of_map[0, cell] += share
            of_map[1, cell] += weight[i]
            of_map[2, cell] += 1


_tally = Compiled(_tally_loop, tally_plain)
