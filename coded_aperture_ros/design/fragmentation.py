"""Best fragmentation of an aperture for scenes in motion: the analysis of thesis 7.4."""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray, IndexArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.likelihood.motion.kernels import Motions, motion_kernel
from coded_aperture_ros.optics import Mask, render_psf_stack

# Side of the smallest hole that still shows a point as one, mm, for a lens of 50 mm (thesis 7.4.1).
SMALLEST_HOLE_MM = 2.79
# Side of the patch whose frequencies are counted, px (thesis 7.4.2).
PATCH_PX = 64
# Noise levels of thesis 7.4.2, relative to the brightness.
NOISE_LEVELS = tuple(np.arange(1, 11) / 100)
# The experiments of thesis table 7.1. It does not say how large blur and motion are; 12 px is its
# longest motion in a photograph.
LEVELS = 10
DIRECTIONS = 8
LENGTHS = 8
BLUR_SIZES_PX = tuple(np.linspace(7.0, 25.0, LEVELS))
LENGTHS_PX = tuple(1.5 * np.arange(1, LENGTHS + 1))
# More placements than this are not all tried: as many at random are, and improved by exchanges.
MOST_PLACEMENTS = 3000
Cells = tuple[int, ...]
# How finely the disc is drawn, cells for each of the grid's.
_DISC_CELLS = 32
_SUBCELLS = 8


def table_motions() -> Motions:
    """64 motions of thesis table 7.1, in order of direction, then length."""
    return Motions.grid(DIRECTIONS, LENGTHS_PX, static=False)


def most_holes(
    focal_length_mm: float, f_number: float, smallest_hole_mm: float = SMALLEST_HOLE_MM
) -> int:
    """Number of square holes with as much light as a round aperture (eq. 7.5).

    `smallest_hole_mm` is the side of the smallest hole that diffraction allows.
    """
    _check_positive(
        focal_length_mm=focal_length_mm, f_number=f_number, smallest_hole_mm=smallest_hole_mm
    )
    return int(math.pi * (focal_length_mm / (2 * f_number)) ** 2 / smallest_hole_mm**2)


def hole_side_mm(focal_length_mm: float, f_number: float, holes: int) -> float:
    """Side of square holes with the light of a round aperture (eq. 7.6), mm."""
    _check_positive(focal_length_mm=focal_length_mm, f_number=f_number, holes=holes)
    return math.sqrt(math.pi / holes) * focal_length_mm / (2 * f_number)


def round_mask(grid: int, holes: int) -> Mask:
    """Disc with the light of `holes` cells of a grid, as a mask of that grid's extent.

    An `InputError` where the disc is larger than the grid.
    """
    radius = math.sqrt(holes / math.pi) / grid  # of the extent
    if radius > 0.5:
        raise InputError(
            f"{holes} holes in a {grid}x{grid} grid: a disc of as much light is larger than the "
            "grid: take fewer holes"
        )
    cells = grid * _DISC_CELLS
    fine = (np.arange(cells * _SUBCELLS) + 0.5) / (cells * _SUBCELLS) - 0.5
    inside = np.hypot(fine[:, None], fine) <= radius
    coverage = inside.reshape(cells, _SUBCELLS, cells, _SUBCELLS).mean(axis=(1, 3))
    return Mask("disc", coverage.astype(np.float32))


@dataclasses.dataclass(frozen=True, eq=False)
class Fragmentation:
    """Frequencies that each placement of holes preserves."""

    masks: list[Mask]  # placements, no two of them alike but for a turn or a reflection
    # ``M_w`` of eq. 7.8 as a share of all frequencies, levels and motions [placements, noises].
    preserved: DoubleArray
    disc: Mask  # the round aperture of equal light
    disc_preserved: DoubleArray  # [noises]
    noise_levels: tuple[float, ...]
    placements: int  # how many ways there are to place the holes, turned ones and all
    exhaustive: bool  # whether all of them were tried

    def best(self, lowest: float, highest: float) -> int:
        """Index of the placement that preserves most over the noise levels in a range."""
        levels = np.array(self.noise_levels)
        chosen = (levels > lowest - 1e-9) & (levels < highest + 1e-9)
        if not chosen.any():
            raise InputError(f"noise: none of the levels is from {lowest:g} to {highest:g}")
        return int(np.argmax(self.preserved[:, chosen].sum(axis=1)))


def analyse_fragmentation(
    grid: int,
    holes: int,
    blur_sizes_px: ArrayLike,
    motions: Motions,
    noise_levels: Iterable[float] = NOISE_LEVELS,
    progress: Progress = iter,
    seed: int = 0,
) -> Fragmentation:
    """Frequencies above the noise for every way to place holes (thesis 7.4.2).

    Parameters
    ----------
    grid, holes : int
        Cells along a side of the grid, and the number of open ones.
    blur_sizes_px : array_like
        Extents of the grid in the image, px.
    motions : Motions
    noise_levels : iterable of float, optional
        ``w`` of eq. 7.8; the texture has 1 at every frequency.
    progress : callable, optional
        Wraps the iteration over placements.
    seed : int, optional
        Of the placements that are tried if there are too many to try all.

    Raises
    ------
    InputError
        If the holes do not fit the grid, or a disc of their light does not.
    """
    if grid < 1 or not 1 <= holes <= grid**2:
        raise InputError(f"{holes} holes: expected 1 to {grid**2} in a grid of {grid}x{grid}")
    disc = round_mask(grid, holes)
    noise = tuple(noise_levels)
    traces = [transfer(motion_kernel((right, down))) for right, down in motions.vectors_px]
    preserved = functools.partial(_preserved, blur_sizes_px, np.array(traces), noise)
    turned = _turned(grid)
    total = math.comb(grid**2, holes)
    exhaustive = total <= 8 * MOST_PLACEMENTS
    drawn: Iterable[Cells] = itertools.combinations(range(grid**2), holes)
    if not exhaustive:
        random = np.random.default_rng(seed)
        draws = range(MOST_PLACEMENTS // 4)
        drawn = (tuple(random.choice(grid**2, holes, replace=False)) for _ in draws)
    # One of each set of placements that are turns and reflections of each other.
    candidates = sorted({_first(cells, turned) for cells in drawn})
    measured = {cells: preserved(_mask(grid, cells)) for cells in progress(candidates)}
    if not exhaustive:
        measured.update(_improved(grid, measured, turned, preserved))
    order = sorted(measured, key=lambda cells: (-measured[cells].sum(), cells))
    return Fragmentation(
        masks=[_mask(grid, cells) for cells in order],
        preserved=np.array([measured[cells] for cells in order]),
        disc=disc,
        disc_preserved=preserved(disc),
        noise_levels=noise,
        placements=total,
        exhaustive=exhaustive,
    )


def _preserved(
    blur_sizes_px: ArrayLike, traces: FloatArray, noises: tuple[float, ...], mask: Mask
) -> DoubleArray:
    """Share of the frequencies that stay above each noise (eq. 7.8)."""
    motions, rows, columns = traces.shape
    once = (np.arange(columns) == 0) | (2 * (columns - 1) == np.arange(columns))
    counts = np.broadcast_to(np.where(once, 1.0, 2.0), (rows, columns)).ravel()
    stack = render_psf_stack(mask, blur_sizes_px)
    above = np.zeros(len(noises))
    for psf in stack.psfs:
        passed = traces.reshape(motions, -1) * transfer(psf).ravel()
        above += [((passed > noise) @ counts).sum() for noise in noises]
    return above / (len(stack) * motions * counts.sum())


def transfer(psf: FloatArray) -> FloatArray:
    """Modulus of a PSF's Fourier coefficients for a patch of `PATCH_PX`, as ``rfft2``.

    A PSF wider than the patch wraps around, as the patch itself is taken to.
    """
    side = PATCH_PX * math.ceil(len(psf) / PATCH_PX)
    padded = np.zeros((side, side))
    padded[: len(psf), : len(psf)] = psf
    folded = padded.reshape(side // PATCH_PX, PATCH_PX, side // PATCH_PX, PATCH_PX).sum(axis=(0, 2))
    return np.abs(scipy.fft.rfft2(folded)).astype(np.float32)


def _improved(
    grid: int,
    measured: dict[Cells, DoubleArray],
    turned: list[IndexArray],
    preserved: Callable[[Mask], DoubleArray],
) -> Iterator[tuple[Cells, DoubleArray]]:
    """Placements tried while single holes of the best one move to better cells."""
    best = max(measured, key=lambda cells: float(measured[cells].sum()))
    most = measured[best].sum()
    better = True
    while better:
        better = False
        for hole, place in itertools.product(range(len(best)), range(grid**2)):
            if place in best:
                continue
            cells = _first((*best[:hole], place, *best[hole + 1 :]), turned)
            found = preserved(_mask(grid, cells))
            yield cells, found
            if found.sum() > most:
                best = cells
                most = found.sum()
                better = True
                break


def _turned(grid: int) -> list[IndexArray]:
    """Position of every cell in each of the eight turns and reflections."""
    cells = np.arange(grid**2).reshape(grid, grid)
    turns = [np.rot90(cells, turn) for turn in range(4)]
    return [np.argsort(turn.ravel()) for turn in (*turns, *(turn.T for turn in turns))]


def _first(cells: Cells, turned: list[IndexArray]) -> Cells:
    """First in order of all turns and reflections of a placement."""
    chosen = list(cells)
    return min(tuple(int(cell) for cell in np.sort(turn[chosen])) for turn in turned)


def _mask(grid: int, cells: Cells) -> Mask:
    transmission = np.zeros(grid**2, np.float32)
    transmission[list(cells)] = 1
    rows = transmission.reshape(grid, grid)
    return Mask("-".join("".join("01"[int(cell)] for cell in row) for row in rows), rows)


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not 0 < value < math.inf:
            raise InputError(f"{name}: expected more than 0, got {value!r}")
