"""Features of a frame's windows: how well the bank explains them, and other PSFs do."""

import dataclasses
from functools import lru_cache

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
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
    quantiles,
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
_FEWEST_WINDOWS = 4
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

    features: list[float]  # for the network
    rows: IndexArray  # [n]; pixels at the windows' centres
    columns: IndexArray
    size_px: DoubleArray  # [n]; blur size of the likeliest level, without sign
    weight: DoubleArray  # [n]; by texture; the sum is 1


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
        self._sizes_px, self._own = own.sizes_px, PsfHypotheses.from_psfs(own.psfs)
        groups = [others[name] for name in NAMES if name in others]
        self._others = PsfHypotheses.concatenate(groups)
        self._starts = np.cumsum([0, *(group.weights.shape[1] for group in groups[:-1])])
        self._present = np.flatnonzero([name in others for name in NAMES])

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
        tops, lefts = chosen_windows(grey, unusable, cells)
        if len(tops) < _FEWEST_WINDOWS:
            return None
        cuts = [
            np.s_[t : t + WINDOW_PX, x : x + WINDOW_PX] for t, x in zip(tops, lefts, strict=True)
        ]
        power = power_spectra(np.stack([grey[cut] for cut in cuts])) / np.float32(noise**2)
        scores = negative_log_likelihood(power, self._own)
        best = scores.reshape(len(power), -1).argmin(axis=1)
        contrast, kind = np.unravel_index(best, scores.shape[1:])
        level, slope = np.divmod(kind, len(SLOPES))
        least = scores[np.arange(len(power)), contrast, kind]
        better = self._gains(power, least, contrast)
        # Residual of the best hypothesis: 1 on the mean, and scattered like the power of noise.
        share = frequencies().share
        own_noise = np.exp(least - self._own.log_determinants[contrast, kind])
        residual = self._own.weights[contrast, kind] * power
        residual /= share
        residual /= own_noise[:, None]
        scatter = -(np.log(np.maximum(residual, 1e-6)) @ share)
        texture = np.log10(np.maximum(power @ share, 1.0))
        weight = np.clip(texture - 0.15, 0.02, 1.5)
        weight /= weight.sum()
        sizes_px, logarithm = self._sizes_px, np.log(own_noise)
        ordered = np.sort(better, axis=1)
        clipped = np.clip(better, -_MOST_GAIN, _MOST_GAIN)
        extreme = np.clip(better, -_EXTREME_GAIN, _EXTREME_GAIN)
        features = [
            *(weight @ clipped),
            *quantiles(extreme, 0.25, 0.5, 0.75, 0.9).flat,
            *(weight @ (better > _GAIN)),
            *(weight @ (better < -_GAIN)),
            *(weight @ np.clip(ordered[:, [-1, -2]], -_MOST_GAIN, _MOST_GAIN)),
            weight @ scatter,
            *quantiles(scatter, 0.25, 0.75),
            weight @ logarithm,
            *quantiles(logarithm, 0.25),
            texture.mean(),
            *quantiles(texture, 0.9),
            weight @ (level == 0),
            weight @ (level == len(sizes_px) - 1),
            weight @ sizes_px[level] / _SIZE_UNIT_PX,
            sizes_px.min() / _SIZE_UNIT_PX,
            sizes_px.max() / _SIZE_UNIT_PX,
            weight @ (slope == 0),
            weight @ (contrast == len(self._own.weights) - 1),
            *_residuals(np.minimum(residual, _LARGEST_RESIDUAL), sizes_px[level], weight),
        ]
        half = WINDOW_PX // 2
        return Evidence(
            [float(x) for x in features], tops + half, lefts + half, sizes_px[level], weight
        )

    def _gains(self, power: FloatArray, least: FloatArray, contrast: IndexArray) -> FloatArray:
        """Gain of each alternative over the bank for each window [n, len(NAMES)], hundredths.

        Only contrasts near those that explain the windows best are tried: others take time and
        change nothing.
        """
        found = np.full((len(power), len(NAMES)), _MISSING_GAIN, np.float32)
        each = negative_log_likelihood(power, self._others.near_contrasts(contrast)).min(axis=1)
        best = np.minimum.reduceat(each, self._starts, axis=1)
        found[:, self._present] = 100 * (least[:, None] - best)
        return found


def chosen_windows(
    grey: FloatArray, unusable: BoolArray | None, cells: int
) -> tuple[IndexArray, IndexArray]:
    """First row and column of the most textured window of every cell [n]."""
    try:
        grid = PatchGrid.covering(grey.shape, WINDOW_PX, _STRIDE_PX)
    except InputError:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    half = WINDOW_PX // 2
    some = grey[::2]  # every other row is enough for the texture
    fine = cv2.absdiff(some, cv2.blur(some, (_BLUR_PX, _BLUR_PX // 2)))
    blocks = [max(length // _STRIDE_PX, 1) for length in grey.shape[::-1]]
    mean = cv2.blur(cv2.resize(fine, blocks, interpolation=cv2.INTER_AREA), (3, 3))
    texture = grid.centre_values(mean, _STRIDE_PX)
    if unusable is not None:
        share = window_means(unusable.astype(np.float32), grid, WINDOW_PX * 3 // 4)
        texture[share > _UNUSABLE_SHARE] = -1
    found = []
    down, across = (
        np.array_split(np.arange(length), min(cells, length)) for length in texture.shape
    )
    for rows in down:
        for columns in across:
            cell = texture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            row, column = divmod(int(cell.argmax()), len(columns))
            if cell[row, column] > 0:
                found.append((rows[row], columns[column]))
    at_row, at_column = np.array(found, np.intp).reshape(-1, 2).T
    return grid.row_centres[at_row] - half, grid.column_centres[at_column] - half


def _residuals(residual: FloatArray, size_px: DoubleArray, weight: DoubleArray) -> list[float]:
    """Features of the residual's spectrum.

    By frequency and direction, for motion and processing, and by frequency times blur size, where
    another mask leaves the same pattern at all depths.
    """
    at = frequencies()
    mean = np.maximum(weight @ residual, 1e-3)
    band_sums, band_counts = (np.bincount(_band_cells(), values) for values in (mean, None))
    of_rings = np.zeros((2, (RINGS + 1) * SECTORS))
    of_map = np.zeros((3, MAP_ROWS * MAP_COLUMNS))
    arrays = at.radius, at.vertical, at.horizontal, _sectors()
    _tally(residual, size_px, weight, arrays, (of_rings, of_map))
    enough = of_map[2] > min(_MAP_LEAST, of_map[2].max() - 1)
    pattern = np.log(of_map[0, enough] / of_map[1, enough])
    rings = of_rings.reshape(2, -1, SECTORS)[:, :RINGS]
    rings = np.log((rings[0] + 0.002) / (rings[1] + 0.002))
    ring_mean = rings.mean(axis=1)
    return [
        *np.log(band_sums / band_counts),
        *ring_mean,
        rings.std(),
        np.abs(rings - ring_mean[:, None]).mean(),
        np.sqrt(np.mean(pattern**2)),
        *quantiles(pattern, 0.05, 0.95),
        pattern.mean(),
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
