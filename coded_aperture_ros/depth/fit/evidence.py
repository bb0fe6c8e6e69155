"""How well a frame's windows are explained by the bank, and how much better by something else."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.depth.fit.alternatives import NAMES, alternatives, levels_beyond, own_levels
from coded_aperture_ros.depth.fit.spectra import (
    TEXTURES,
    WINDOW_PX,
    Frequencies,
    Hypotheses,
    frequencies,
    powers,
    surprise,
)
from coded_aperture_ros.imaging import PatchGrid
from coded_aperture_ros.optics import PsfStack

# Windows are chosen one to a cell of so many a side, those with the most texture.
_CELLS, _STRIDE_PX, _FEWEST = 10, 8, 4
_BLUR_PX = 15
_TOLERATED = 0.005
# In hundredths of a unit of surprise: 1 is far more than chance for one window.
_BETTER, _MOST, _EXTREME = 0.3, 6.0, 10.0
_ABSENT = -2.0
_LARGEST_RESIDUAL = 12.0
_SIZE_UNIT_PX = 20.0
_BANDS, _DIRECTIONS = (0.1, 0.2, 0.3, 0.4), 8
_RINGS, _SECTORS = 12, 4
_MAP_ROWS, _MAP_COLUMNS, _MAP_STEPS, _MAP_LEAST = 31, 15, 2.5, 30


@dataclasses.dataclass(frozen=True, eq=False)
class Evidence:
    """What the windows of a frame say.

    Attributes
    ----------
    features : list of float
        For the network.
    rows, columns : ndarray, intp [n]
        Pixels at the windows' centres.
    size_px : ndarray, float64 [n]
        Blur size of the level that explains each best, without sign.
    weight : ndarray, float [n]
        How much each tells; the sum is 1.
    """

    features: list[float]
    rows: IndexArray
    columns: IndexArray
    size_px: DoubleArray
    weight: DoubleArray


class Witness:
    """Compares the levels of a bank with what the lens may be instead; see `alternatives`.

    With `guarded`, the ends of the bank stand for all that is beyond them, which is its own then.
    """

    def __init__(self, stack: PsfStack, guarded: bool = False) -> None:
        own = own_levels(stack)
        beyond, others = levels_beyond(own), alternatives(own)
        if guarded:
            own = own.with_others(beyond)
        elif beyond.psfs:
            others["beyond"] = Hypotheses.of(beyond.psfs)
        self._sizes_px, self._own = own.sizes_px, Hypotheses.of(own.psfs)
        groups = [self._own, *(others[name] for name in NAMES if name in others)]
        self._all = Hypotheses(
            np.concatenate([group.weights for group in groups]),
            np.concatenate([group.log_determinants for group in groups]),
        )
        ends = np.cumsum([len(group.weights) for group in groups])
        self._groups = [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]
        self._present = [name in others for name in NAMES]

    def ask(self, grey: FloatArray, noise: float, unusable: BoolArray | None) -> Evidence | None:
        """Return what the windows of a frame say; None if there are too few.

        Parameters
        ----------
        grey : ndarray, float32 [height, width]
            Linear light, without NaN.
        noise : float
            Its standard deviation, > 0.
        unusable : ndarray, bool [height, width], optional
            Pixels that were filled in.
        """
        tops, lefts = _chosen_windows(grey, unusable)
        if len(tops) < _FEWEST:
            return None
        cuts = [
            np.s_[t : t + WINDOW_PX, x : x + WINDOW_PX] for t, x in zip(tops, lefts, strict=True)
        ]
        power = powers(np.stack([grey[cut] for cut in cuts])) / np.float32(noise**2)
        surprises = surprise(power, self._all)
        own = surprises[:, self._groups[0]]
        best, each = own.argmin(axis=1), np.arange(len(own))
        least = own[each, best]
        better = self._better(surprises, least)
        # What the best hypothesis leaves: 1 on the mean, and scattered like the power of noise.
        own_noise = np.exp(least - self._own.log_determinants[best])
        share = frequencies().share
        residual = power * (self._own.weights[best] / share) / own_noise[:, None]
        scatter = -(np.log(np.maximum(residual, 1e-6)) @ share)
        texture = np.log10(np.maximum(power @ share, 1.0))
        weight = np.clip(texture - 0.15, 0.02, 1.5)
        weight /= weight.sum()
        level, kind = np.divmod(best, TEXTURES)
        size_px = self._sizes_px[level]
        logarithm = np.log(own_noise)
        ordered = np.sort(better, axis=1)
        clipped = np.clip(better, -_MOST, _MOST)
        features = [
            *(weight @ clipped),
            *np.quantile(np.clip(better, -_EXTREME, _EXTREME), (0.25, 0.5, 0.75, 0.9), axis=0).flat,
            *(weight @ (better > _BETTER)),
            *(weight @ (better < -_BETTER)),
            *(weight @ np.clip(ordered[:, [-1, -2]], -_MOST, _MOST)),
            weight @ scatter,
            *np.quantile(scatter, (0.25, 0.75)),
            weight @ logarithm,
            np.quantile(logarithm, 0.25),
            texture.mean(),
            np.quantile(texture, 0.9),
            weight @ (level == 0),
            weight @ (level == len(self._sizes_px) - 1),
            weight @ size_px / _SIZE_UNIT_PX,
            self._sizes_px.min() / _SIZE_UNIT_PX,
            self._sizes_px.max() / _SIZE_UNIT_PX,
            weight @ (kind < TEXTURES // 2),
            weight @ (kind % (TEXTURES // 2) == TEXTURES // 2 - 1),
            *_residuals(np.minimum(residual, _LARGEST_RESIDUAL), size_px, weight),
        ]
        half = WINDOW_PX // 2
        return Evidence([float(x) for x in features], tops + half, lefts + half, size_px, weight)

    def _better(self, surprises: FloatArray, least: FloatArray) -> FloatArray:
        """Return by how much each alternative explains each window better [n, len(NAMES)]."""
        found = np.full((len(least), len(NAMES)), _ABSENT, np.float32)
        for column, of in zip(np.flatnonzero(self._present), self._groups[1:], strict=True):
            found[:, column] = 100 * (least - surprises[:, of].min(axis=1))
        return found


def _chosen_windows(grey: FloatArray, unusable: BoolArray | None) -> tuple[IndexArray, IndexArray]:
    """Return the first row and column of the most textured window of every cell [n]."""
    try:
        grid = PatchGrid.covering(grey.shape, WINDOW_PX, _STRIDE_PX)
    except InputError:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    at = np.ix_(grid.row_centres, grid.column_centres)
    half = WINDOW_PX // 2
    fine = cv2.absdiff(grey, cv2.blur(grey, (_BLUR_PX, _BLUR_PX)))
    texture = cv2.blur(fine, (half, half))[at]
    if unusable is not None:
        side = WINDOW_PX * 3 // 4
        texture[cv2.blur(unusable.astype(np.float32), (side, side))[at] > _TOLERATED] = -1
    found = []
    for rows in np.array_split(np.arange(grid.rows), min(_CELLS, grid.rows)):
        for columns in np.array_split(np.arange(grid.columns), min(_CELLS, grid.columns)):
            cell = texture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            row, column = divmod(int(cell.argmax()), len(columns))
            if cell[row, column] > 0:
                found.append((rows[row], columns[column]))
    at_row, at_column = np.array(found, np.intp).reshape(-1, 2).T
    return grid.row_centres[at_row] - half, grid.column_centres[at_column] - half


def _residuals(residual: FloatArray, size_px: DoubleArray, weight: DoubleArray) -> list[float]:
    """Return where in the spectrum the bank is wrong.

    By frequency and direction: what motion and processing do. And by frequency in units of the PSF,
    where another pattern leaves the same traces at all depths.
    """
    at, found = frequencies(), []
    mean = np.maximum(weight @ residual, 1e-3)
    band, direction = np.digitize(at.radius, _BANDS), at.directions(_DIRECTIONS)
    cell = band * _DIRECTIONS + direction
    count = (len(_BANDS) + 1) * _DIRECTIONS
    sums, counts = (np.bincount(cell, values, count) for values in (mean, None))
    found += list(np.log(sums / counts))
    found += _of_rings(residual, size_px, weight, at)
    column = np.clip(
        (np.outer(size_px, at.horizontal) * _MAP_STEPS).astype(int), 0, _MAP_COLUMNS - 1
    )
    row = np.outer(size_px, at.vertical) * _MAP_STEPS + _MAP_ROWS // 2
    cell = (column * _MAP_ROWS + np.clip(row.astype(int), 0, _MAP_ROWS - 1)).ravel()
    weights, count = np.repeat(weight, residual.shape[1]), _MAP_ROWS * _MAP_COLUMNS
    seen = np.bincount(cell, minlength=count)
    enough = seen > min(_MAP_LEAST, seen.max() - 1)
    sums, total = (
        np.bincount(cell, values, count)[enough] for values in (weights * residual.ravel(), weights)
    )
    pattern = np.log(sums / total)
    return [
        *found,
        np.sqrt(np.mean(pattern**2)),
        *np.quantile(pattern, (0.05, 0.95)),
        pattern.mean(),
    ]


def _of_rings(
    residual: FloatArray, size_px: DoubleArray, weight: DoubleArray, at: Frequencies
) -> list[float]:
    ring = np.minimum(np.outer(2 * size_px, at.radius).astype(int), _RINGS)
    cell = ring * _SECTORS + at.directions(_SECTORS)
    weights = np.repeat(weight, residual.shape[1])
    sums, total = (
        np.bincount(cell.ravel(), values, (_RINGS + 1) * _SECTORS).reshape(-1, _SECTORS)[:_RINGS]
        for values in (weights * residual.ravel(), weights)
    )
    rings = np.log((sums + 0.002) / (total + 0.002))
    mean = rings.mean(axis=1)
    return [*mean, rings.std(), np.abs(rings - mean[:, None]).mean()]
