"""Finding a grid of dots in a picture, however wide the dots are blurred.

A dot seen through a mask is not one spot but several, so that spots are not looked for. The grid
repeats: the autocorrelation of the picture is highest at the grid's own steps. Smoothed over a
third of a step, each dot is one hill, whatever its shape.
"""

import dataclasses
from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from coded_aperture_ros.errors import InputError

# Larger pictures are reduced for the search: the grid is found to a fraction of a step anyway.
_LONGEST_SIDE_PX = 1600
_SHORTEST_STEP_PX = 5
_SOFTENING_PX = 1.5
# Steps of the grid are about equally high in the autocorrelation; four holes of a mask are not
# more than half as high.
_STEP_HEIGHT = 0.7
# Of the autocorrelation without shift, noise left out; a picture without a grid has less.
_LEAST_HEIGHT = 0.1
_SMOOTHING = 0.3
_DIMMEST = 0.25
# How far from its place a dot may be found, in steps.
_TOLERANCE = 0.2
# Also beyond the next place, where there may be no dot; the nearest first.
_NEIGHBOURS = (
    *((0, 1), (0, -1), (1, 0), (-1, 0)),
    *((1, 1), (-1, -1), (1, -1), (-1, 1)),
    *((0, 2), (0, -2), (2, 0), (-2, 0)),
)
_BACKGROUND_DEGREE = 4
_BACKGROUND_ROUNDS = 8


@dataclasses.dataclass(frozen=True, eq=False)
class DotGrid:
    """A grid of dots in a picture.

    Attributes
    ----------
    positions : ndarray of float64, shape [N, 2]
        Row and column in px of each dot found, as a smooth grid through all of them has it.
    spacing_px : float
        Shortest distance of two neighbours in the grid.
    off_grid : int
        Spots that are not dots of the grid.
    missing : int
        Places within the grid where no dot was found.
    """

    positions: NDArray[np.float64]
    spacing_px: float
    off_grid: int
    missing: int


def find_grid(light: NDArray[np.floating]) -> DotGrid:
    """Find the grid of bright dots in a picture without background.

    Parameters
    ----------
    light : ndarray of float, shape [rows, columns]
        Light above the background; see `above_background`.

    Returns
    -------
    DotGrid

    Raises
    ------
    InputError
        If nothing repeats in the picture, or its spots form no grid.
    """
    factor = int(np.ceil(max(light.shape) / _LONGEST_SIDE_PX))
    if factor > 1:
        rows, columns = (length // factor for length in light.shape)
        cut = np.ascontiguousarray(light[: rows * factor, : columns * factor], np.float32)
        light = cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA)
    basis = _basis_of(np.asarray(light, np.float64))
    spots = _spots(light, basis)
    steps, known = _steps_of(spots, basis)
    if len(steps) < 4 or min(np.ptp(steps, axis=0)) < 1:
        raise InputError(
            "no grid of dots: the spots in it do not lie on one; photograph a square grid of equal "
            "dots, at least three rows and columns"
        )
    places, on_grid = _smooth_grid(steps, spots[known], float(np.linalg.norm(basis[0])))
    spacing = min(_shortest_step(steps, places), np.inf)
    missing = _holes(steps[on_grid])
    # A pixel of the reduced picture is `factor` pixels wide, and its centre lies in their middle.
    positions = places[on_grid] * factor + (factor - 1) / 2
    return DotGrid(positions, spacing * factor, len(spots) - int(on_grid.sum()), missing)


def above_background(
    picture: NDArray[np.floating],
) -> tuple[NDArray[np.float32], NDArray[np.float32], bool]:
    """Take the background off a picture of dots.

    Parameters
    ----------
    picture : ndarray of float, shape [rows, columns]
        Bright dots on a dark background, or dark ones on a bright one; linear light.

    Returns
    -------
    light : ndarray of float32, shape [rows, columns]
        What the dots add to the background, or take away from it: positive either way.
    background : ndarray of float32, shape [rows, columns]
        A polynomial through what is left of the picture without dots.
    dark : bool
        Whether the dots are darker than the background.
    """
    step = max(1, max(picture.shape) // 200)
    small = np.asarray(cv2.blur(picture.astype(np.float32), (step, step)), np.float64)
    rows, columns = (np.linspace(-1, 1, length) for length in picture.shape)
    sampled = small[::step, ::step]
    terms = _polynomials(rows[::step], columns[::step])
    values = sampled.ravel()
    # Dots are a minority on one side of the background; which side shows after the first fits.
    fitted, kept = values, np.ones(values.size, bool)
    for _ in range(_BACKGROUND_ROUNDS):
        weights = np.linalg.lstsq(terms[kept], values[kept], rcond=None)[0]
        fitted = terms @ weights
        rest = values - fitted
        spread = 1.4826 * np.median(np.abs(rest[kept] - np.median(rest[kept])))
        middle = np.median(rest[kept])
        kept = np.abs(rest - middle) <= 2.0 * spread + 1e-9
    rest = values - fitted
    dark = bool(np.sum(rest**3) < 0)
    full = _polynomials(rows, columns) @ weights
    background = full.reshape(picture.shape).astype(np.float32)
    light = picture - background
    return (-light if dark else light).astype(np.float32), background, dark


def _polynomials(rows: NDArray, columns: NDArray) -> NDArray[np.float64]:
    degrees = range(_BACKGROUND_DEGREE + 1)
    terms = [
        np.outer(rows**i, columns**j).ravel()
        for i in degrees
        for j in degrees
        if i + j <= _BACKGROUND_DEGREE
    ]
    return np.stack(terms, axis=1)


def _basis_of(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the two shortest steps of the grid [2, 2], from the autocorrelation."""
    # Dots a little off the grid still lie on each other once they are smooth.
    light = ndimage.gaussian_filter(light, _SOFTENING_PX)
    height, width = light.shape
    shape = [fft.next_fast_len(2 * length, real=True) for length in light.shape]
    power = np.abs(fft.rfft2(light, shape)) ** 2
    sums = fft.irfft2(power, shape)
    reach = height // 2, width // 2
    down = np.arange(reach[0] + 1)
    right = np.arange(-reach[1], reach[1] + 1)
    overlap = np.outer(height - down, width - np.abs(right))
    correlation = sums[np.ix_(down, right)] / overlap
    peaks = ndimage.maximum_filter(correlation, 5, mode="nearest") == correlation
    half = (down[:, None] > 0) | (right[None, :] > 0)
    far = np.hypot(down[:, None], right[None, :]) >= _SHORTEST_STEP_PX
    rows, columns = np.nonzero(peaks & half & far)
    heights = correlation[rows, columns]
    # One step to the side, the noise no longer correlates with itself.
    without_noise = correlation[0, reach[1] + 1]
    if not heights.size or not heights.max() > max(_LEAST_HEIGHT * without_noise, 0.0):
        raise InputError(
            "no dots that repeat: photograph a square grid of bright dots on a dark background, or "
            "of dark dots on a bright one, that fills the picture"
        )
    vectors = np.stack([down[rows], right[columns]], axis=1)[
        heights > _STEP_HEIGHT * heights.max()
    ].astype(np.float64)
    lengths = np.linalg.norm(vectors, axis=1)
    order = np.argsort(lengths)
    vectors, lengths = vectors[order], lengths[order]
    sine = np.abs(vectors[:, 0] * vectors[0, 1] - vectors[:, 1] * vectors[0, 0])
    sine /= lengths * lengths[0]
    across = np.flatnonzero(sine > 0.5)
    if not across.size:
        raise InputError(
            "the dots repeat in one direction only: photograph a square grid of dots that fills "
            "the picture"
        )
    return np.stack([vectors[0], vectors[across[0]]])


def _spots(light: NDArray[np.floating], basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return row and column of every hill of a picture smoothed over a part of a step [N, 2]."""
    step = float(np.linalg.norm(basis[0]))
    smooth = ndimage.gaussian_filter(np.asarray(light, np.float64), _SMOOTHING * step)
    side = max(3, round(0.6 * step))
    hills = (ndimage.maximum_filter(smooth, side) == smooth) & (smooth > 0)
    rows, columns = np.nonzero(hills)
    inside = (
        (rows > 0) & (rows < light.shape[0] - 1) & (columns > 0) & (columns < light.shape[1] - 1)
    )
    rows, columns = rows[inside], columns[inside]
    heights = smooth[rows, columns]
    expected = max(4, int(light.size / abs(np.linalg.det(basis))))
    usual = np.median(np.sort(heights)[::-1][:expected]) if heights.size else 0.0
    bright = heights > _DIMMEST * usual
    rows, columns = rows[bright], columns[bright]
    spots = np.stack([rows, columns], axis=1).astype(np.float64)
    for axis, (down, right) in enumerate(((1, 0), (0, 1))):
        before = smooth[rows - down, columns - right]
        after = smooth[rows + down, columns + right]
        bend = 2 * smooth[rows, columns] - before - after
        spots[:, axis] += np.where(bend > 0, (after - before) / np.maximum(2 * bend, 1e-12), 0)
    return spots


def _steps_of(
    spots: NDArray[np.float64], basis: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Count the steps from one spot to the others, from neighbour to neighbour.

    Returns the steps [N, 2] and the numbers of the spots [N] that can be reached so.
    """
    if not len(spots):
        return np.empty((0, 2), np.int64), np.empty(0, np.int64)
    middle = spots.mean(axis=0)
    best: dict[int, tuple[int, int]] = {}
    # The spot in the middle may be a speck of dust: start from another one then.
    for start in np.argsort(np.linalg.norm(spots - middle, axis=1))[:5]:
        found = {int(start): (0, 0)}
        taken = {(0, 0)}
        waiting = deque(found)
        while waiting:
            here = waiting.popleft()
            for i, j in _NEIGHBOURS:
                step = found[here][0] + i, found[here][1] + j
                move = i * basis[0] + j * basis[1]
                distance = np.linalg.norm(spots - spots[here] - move, axis=1)
                there = int(np.argmin(distance))
                near = distance[there] <= _TOLERANCE * np.linalg.norm(basis[0])
                if near and there not in found and step not in taken:
                    found[there] = step
                    taken.add(step)
                    waiting.append(there)
        if len(found) > len(best):
            best = found
    return np.array(list(best.values())), np.array(list(best))


def _smooth_grid(
    steps: NDArray[np.int64], spots: NDArray[np.float64], step_px: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return where a smooth grid has each spot [N, 2], and which spots lie near that."""
    kept = np.ones(len(steps), bool)
    scaled = steps / max(1, np.abs(steps).max())
    places = spots
    for _ in range(5):
        degree = 3 if kept.sum() >= 40 else 2 if kept.sum() >= 16 else 1
        terms = np.stack(
            [
                scaled[:, 0] ** i * scaled[:, 1] ** j
                for i in range(degree + 1)
                for j in range(degree + 1 - i)
            ],
            axis=1,
        )
        places = terms @ np.linalg.lstsq(terms[kept], spots[kept], rcond=None)[0]
        distance = np.linalg.norm(spots - places, axis=1)
        kept = distance <= max(4 * float(np.median(distance)), 0.05 * step_px)
    return places, kept


def _shortest_step(steps: NDArray[np.int64], places: NDArray[np.float64]) -> float:
    """Return the shortest distance of two neighbours anywhere in the grid, in px."""
    where = {tuple(step): place for step, place in zip(steps.tolist(), places, strict=True)}
    return min(
        float(np.linalg.norm(where[neighbour] - place))
        for (i, j), place in where.items()
        for neighbour in ((i + 1, j), (i, j + 1))
        if neighbour in where
    )


def _holes(steps: NDArray[np.int64]) -> int:
    """Count the places that have dots on both sides in their row and in their column."""
    first = steps.min(axis=0)
    there = np.zeros(np.ptp(steps, axis=0) + 1, bool)
    there[tuple((steps - first).T)] = True

    def between(grid: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
        before = np.maximum.accumulate(grid, axis=axis)
        after = np.flip(np.maximum.accumulate(np.flip(grid, axis), axis=axis), axis)
        return np.asarray(before & after)

    return int((between(there, 0) & between(there, 1) & ~there).sum())
