"""Positions of the dots of a grid in a picture, however wide they are blurred.

A dot seen through a mask is several spots, so spots are not looked for. The grid repeats: the
autocorrelation of the picture is highest at the grid's own steps. Smoothed over a third of a step,
each dot is one hill, whatever its shape.
"""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray
from coded_aperture_ros.core.errors import InputError

# Larger pictures are reduced for the search: dots are registered in the full picture later.
_LONGEST_SIDE_PX = 1600
_SHORTEST_STEP_PX = 5
_SOFTENING_PX = 1.5
_BACKGROUND = 0.1
# All steps of a grid are about equally high in the autocorrelation; two of a mask's openings that
# lie on each other are not more than half as high.
_STEP_HEIGHT = 0.7
# Least height over that without shift, for which noise alone is too low.
_MIN_HEIGHT = 0.1
_SMOOTHING = 0.3
_DIMMEST = 0.25
# How far from its place a dot may be, in steps.
_TOLERANCE = 0.2
# Two steps away, too: the next dot may be missing.
_NEIGHBOURS = (
    *((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1)),
    *((0, 2), (0, -2), (2, 0), (-2, 0)),
)
_ADVICE = (
    "photograph a square grid of equal small lights on black that fills the picture, with gaps "
    "wider than the blur"
)


@dataclasses.dataclass(frozen=True, eq=False)
class DotLattice:
    """A grid of dots in a picture."""

    # [N, 2]; row and column in px of each dot found, to about a tenth of a step.
    positions: DoubleArray
    spacing_px: float  # shortest step of the grid
    missing: int  # places within the grid where no dot was found


def find_lattice(picture: NDArray[np.floating]) -> DotLattice:
    """Find the grid of bright dots in a finite, linear picture [rows, columns].

    Raises `InputError` if nothing repeats in the picture, or its spots form no grid.
    """
    factor = int(np.ceil(max(picture.shape) / _LONGEST_SIDE_PX))
    rows, columns = (length // factor for length in picture.shape)
    cut = np.ascontiguousarray(picture[: rows * factor, : columns * factor], np.float32)
    small = cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA)
    light = ndimage.gaussian_filter(small.astype(np.float64), _SOFTENING_PX)
    light -= ndimage.gaussian_filter(light, _BACKGROUND * min(light.shape))
    basis = _basis(light)
    hills = _hills(light, basis)
    steps, numbers = _steps(hills, basis)
    if len(steps) < 4 or np.ptp(steps, axis=0).min() < 1:
        raise InputError(f"no grid of dots: the spots in it do not lie on one: {_ADVICE}")
    places, fits = _smooth(steps, hills[numbers], float(np.linalg.norm(basis[0])))
    # A pixel of the reduced picture is `factor` pixels wide, and its centre lies in their middle.
    positions = places[fits] * factor + (factor - 1) / 2
    missing = _missing(steps, places, light.shape)
    return DotLattice(positions, float(np.linalg.norm(basis[0])) * factor, missing)


def _basis(light: NDArray) -> NDArray:
    """Two shortest steps of the grid [2, 2], from the autocorrelation."""
    height, width = light.shape
    shape = [fft.next_fast_len(2 * length, real=True) for length in light.shape]
    sums = fft.irfft2(np.abs(fft.rfft2(light, shape)) ** 2, shape)
    down = np.arange(height // 2 + 1)
    right = np.arange(-(width // 2), width // 2 + 1)
    correlation = sums[np.ix_(down, right)] / np.outer(height - down, width - np.abs(right))
    peaks = ndimage.maximum_filter(correlation, 5, mode="nearest") == correlation
    peaks &= (down[:, None] > 0) | (right[None, :] > 0)
    peaks &= np.hypot(down[:, None], right[None, :]) >= _SHORTEST_STEP_PX
    rows, columns = np.nonzero(peaks)
    heights = correlation[rows, columns]
    if not heights.size or not heights.max() > max(_MIN_HEIGHT * sums[0, 0] / light.size, 1e-12):
        raise InputError(f"no dots that repeat: {_ADVICE}")
    vectors = np.stack([down[rows], right[columns]], axis=1)
    vectors = vectors[heights > _STEP_HEIGHT * heights.max()].astype(np.float64)
    lengths = np.linalg.norm(vectors, axis=1)
    order = np.argsort(lengths)
    vectors = vectors[order]
    lengths = lengths[order]
    sine = np.abs(vectors[:, 0] * vectors[0, 1] - vectors[:, 1] * vectors[0, 0])
    across = np.flatnonzero(sine > 0.5 * lengths * lengths[0])
    if not across.size:
        raise InputError(f"no grid of dots, they repeat in one direction only: {_ADVICE}")
    return np.stack([vectors[0], vectors[across[0]]])


def _hills(light: NDArray, basis: NDArray) -> NDArray:
    """Row and column of every hill of a picture smoothed over a part of a step [N, 2]."""
    step = float(np.linalg.norm(basis[0]))
    smooth = ndimage.gaussian_filter(light, _SMOOTHING * step)
    tops = ndimage.maximum_filter(smooth, max(3, round(0.6 * step))) == smooth
    tops[[0, -1]] = tops[:, [0, -1]] = False
    found = np.argwhere(tops)
    heights = smooth[tops]
    expected = max(4, int(light.size / abs(np.linalg.det(basis))))
    usual = np.median(np.sort(heights)[::-1][:expected]) if heights.size else 0.0
    return found[heights > _DIMMEST * usual].astype(np.float64)


def _steps(hills: NDArray, basis: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Steps [N, 2] from neighbour to neighbour, and the indices of the hills [N] reached so."""
    best: dict[int, tuple[int, int]] = {}
    near_px = _TOLERANCE * np.linalg.norm(basis[0])
    # The hill in the middle may be a speck of dust: start from another one then.
    aside = np.linalg.norm(hills - hills.mean(axis=0), axis=1) if len(hills) else np.empty(0)
    for start in np.argsort(aside)[:5]:
        found = {int(start): (0, 0)}
        taken = {(0, 0)}
        waiting = [int(start)]
        for here in waiting:  # grows while it is gone through
            for i, j in _NEIGHBOURS:
                step = found[here][0] + i, found[here][1] + j
                distance = np.linalg.norm(hills - hills[here] - np.array([i, j]) @ basis, axis=1)
                there = int(np.argmin(distance))
                if distance[there] <= near_px and there not in found and step not in taken:
                    found[there] = step
                    taken.add(step)
                    waiting.append(there)
        best = max(best, found, key=len)
    return np.array(list(best.values()), np.int64).reshape(-1, 2), np.array(list(best), np.int64)


def _smooth(steps: NDArray[np.int64], hills: NDArray, step_px: float) -> tuple[NDArray, BoolArray]:
    """Position of each hill on a polynomial grid [N, 2], and which hills lie near that."""
    kept = np.ones(len(steps), bool)
    i, j = steps.T / max(1, np.abs(steps).max())
    places = hills
    for _ in range(5):
        degree = 3 if kept.sum() >= 40 else 2 if kept.sum() >= 16 else 1
        powers = [(p, q) for p in range(degree + 1) for q in range(degree + 1 - p)]
        terms = np.stack([i**p * j**q for p, q in powers], axis=1)
        places = terms @ np.linalg.lstsq(terms[kept], hills[kept], rcond=None)[0]
        distance = np.linalg.norm(hills - places, axis=1)
        kept = distance <= max(4 * float(np.median(distance)), 0.05 * step_px)
    return places, kept


def _missing(steps: NDArray[np.int64], places: NDArray, shape: tuple[int, ...]) -> int:
    """Number of positions of the grid, well within the picture, without a dot."""
    terms = np.column_stack([steps, np.ones(len(steps))])
    affine = np.linalg.lstsq(terms, places, rcond=None)[0]
    first = steps.min(axis=0)
    last = steps.max(axis=0)
    i, j = np.mgrid[first[0] : last[0] + 1, first[1] : last[1] + 1].reshape(2, -1)
    expected = np.column_stack([i, j, np.ones(i.size)]) @ affine
    margin = 0.75 * np.abs(affine[:2]).sum(axis=0)
    inside = ((expected > margin) & (expected < np.array(shape) - 1 - margin)).all(axis=1)
    there = {tuple(step) for step in steps.tolist()}
    return sum(step not in there for step in zip(i[inside], j[inside], strict=True))
