"""The PSF of one depth from a photograph of a grid of dots (thesis section 6.3.2)."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coded_aperture_ros.calibration.effective import (
    REACH_PX,
    Model,
    Samples,
    fine_psf,
    predict,
)
from coded_aperture_ros.calibration.lattice import DotGrid, above_background, find_grid
from coded_aperture_ros.errors import InputError

_FEWEST_DOTS = 9
_MOST_MISSING = 0.2
_SATURATED = 0.995
# Steps per px at which the PSF is tabulated while the dots are registered.
_FINER = 3
# How wrong the places of the dots may still be after each round, in px.
_MISPLACED_PX = (0.4, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01)
# Thickness of the rim of a dot's window that shows the background only.
_RING_PX = 3
_LARGEST_MOVE_PX = 0.5
_FARTHEST_MOVE = 0.15
# A dot whose difference from the others is larger than usual by this factor shows something else.
_ODD = 4.0
# Power of light on the rim of a dot's window, over that within, from which neighbours overlap.
_OVERLAP = 0.01
_LEAST_SNR = 5.0
_DETECTION = 3.0
_FAINT = 0.02
# Parts of the picture, a side, whose PSFs are compared.
_PARTS = 3


@dataclasses.dataclass(frozen=True, eq=False)
class DotPsf:
    """A PSF measured from dots, not yet centred.

    Attributes
    ----------
    samples : Samples
        The dots, registered to each other: their offsets are relative to the grid's places.
    misplaced_px : float
        Standard deviation of the error of one dot's place.
    snr : float
        Norm of the PSF over that of its noise: noise is the reciprocal of the PSF's relative error.
    field_variation : float
        Largest relative difference (norm) of the PSF in a ninth of the picture from that of all,
        without noise. NaN where no ninth has three dots.
    scatter_px : float
        Standard deviation of the dots' places about a smooth grid.
    spacing_px : float
    used, rejected, missing : int
        Dots; the rejected are cut by the border, saturated, off the grid or unlike the others.
    dark : bool
        Whether the dots were darker than their background.
    """

    samples: Samples
    misplaced_px: float
    snr: float
    field_variation: float
    scatter_px: float
    spacing_px: float
    used: int
    rejected: int
    missing: int
    dark: bool

    def at(
        self, place: NDArray[np.float64], model: Model | None = None
    ) -> tuple[NDArray[np.float64], float]:
        """Return the PSF at whole pixels from a place, and the variance of its values.

        `model` helps between the samples; see `predict`.
        """
        return predict(self.samples, place, self.misplaced_px, model)


def psf_from_dots(picture: NDArray[np.floating], largest_blur_px: float | None = None) -> DotPsf:
    """Measure the PSF from a picture of a grid of dots, all at one depth.

    The dots' places and brightnesses, the background under each (a plane), and the PSF that they
    share are fitted in turn.

    Parameters
    ----------
    picture : ndarray of float, shape [rows, columns] or [rows, columns, 3]
        Linear light in [0, 1]. Bright dots on a dark background or dark ones on a bright one;
        a dot's own width blurs the PSF, so it should be less than half a pixel wide.
    largest_blur_px : float, optional
        Width of the PSF where it is known; by default the dots may be as wide as their spacing.

    Returns
    -------
    DotPsf

    Raises
    ------
    InputError
        If no grid is found, too few dots are left, they overlap, are saturated, or too dim.
    """
    grey = np.asarray(picture, np.float64)
    saturated = np.asarray(grey >= _SATURATED)
    if grey.ndim == 3:
        grey, saturated = grey.mean(axis=2), np.asarray(saturated.any(axis=2))
    if not np.isfinite(grey).all():
        raise InputError("has pixels that are NaN or infinite: use linear pictures of a camera")
    light, background, dark = above_background(grey)
    if dark and background.max() >= _SATURATED:
        raise InputError("the background is saturated: expose for a shorter time")
    grid = find_grid(light)
    if grid.missing > _MOST_MISSING * len(grid.positions):
        raise InputError(
            f"{grid.missing} dots of the grid are missing, {len(grid.positions)} were found: cover "
            "nothing, light the grid evenly, and keep it within the picture"
        )
    if largest_blur_px is None:
        # As wide as the gaps allow, to see how wide the PSF is.
        width = _window_width(grid, None)
        found = _registered(
            grid, *_cut(light, grid, width, saturated), light.shape, dark, _MISPLACED_PX[:2]
        )
        largest_blur_px = _extent(*found.at(np.zeros(2)))
    width = _window_width(grid, largest_blur_px)
    chosen, windows = _cut(light, grid, width, saturated)
    return _registered(grid, chosen, windows, light.shape, dark, _MISPLACED_PX)


def _window_width(grid: DotGrid, largest_blur_px: float | None) -> int:
    room = int(np.floor(grid.spacing_px)) - 1
    room -= 1 - room % 2
    if largest_blur_px is None:
        return room
    size = abs(largest_blur_px)
    if np.ceil(size) + 2 * _RING_PX > room:
        raise InputError(
            f"the dots overlap: they are {grid.spacing_px:.1f} px apart, and a PSF of {size:.1f} "
            f"px needs {np.ceil(size) + 2 * _RING_PX + 2:.0f} px: use a grid with wider gaps"
        )
    # The grid goes through the dots' centres of light, which may lie aside of the mask's middle.
    return min(room, 2 * int(np.ceil(0.65 * size + 2)) + 2 * _RING_PX + 1)


def _cut(
    light: NDArray[np.float32], grid: DotGrid, width: int, saturated: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the numbers of the dots that can be used, and their windows."""
    reach = width // 2 + REACH_PX
    centres = np.rint(grid.positions).astype(np.int64)
    fits = ((centres >= reach) & (centres < np.array(light.shape) - reach)).all(axis=1)
    clipped = np.zeros(len(centres), bool)
    for number in np.flatnonzero(fits):
        row, column = centres[number]
        half = width // 2
        clipped[number] = saturated[
            row - half : row + half + 1, column - half : column + half + 1
        ].any()
    chosen = np.flatnonzero(fits & ~clipped)
    if len(chosen) < _FEWEST_DOTS:
        if clipped.sum() > len(chosen):
            raise InputError(
                f"{clipped.sum()} of {fits.sum()} dots are saturated: expose for a shorter time"
            )
        raise InputError(
            f"only {len(chosen)} whole dots in the picture, at least {_FEWEST_DOTS} are needed: "
            "use a finer grid, fill the picture with it, or light it more"
        )
    windows = np.stack(
        [
            light[row - reach : row + reach + 1, column - reach : column + reach + 1]
            for row, column in centres[chosen]
        ]
    ).astype(np.float64)
    return chosen, windows


def _registered(
    grid: DotGrid,
    chosen: NDArray[np.int64],
    windows: NDArray[np.float64],
    shape: tuple[int, ...],
    dark: bool,
    rounds: Sequence[float],
) -> DotPsf:
    """Register dots to each other by what they show."""
    places = grid.positions[chosen]
    start = places - np.rint(places)
    offsets = start.copy()
    raw = windows
    inner = slice(REACH_PX, -REACH_PX)
    middle = raw[:, inner, inner]
    width = middle.shape[1]
    plane = _planes_under(middle)
    total = (middle - _planes(plane, width)).sum(axis=(1, 2))
    _check_rim(middle - _planes(plane, width), grid.spacing_px)
    usable = total > 0.1 * np.median(total)
    if np.median(total) <= 0 or usable.sum() < _FEWEST_DOTS:
        raise InputError("too little light: expose for longer, or use brighter dots")
    chosen, places, start, offsets = chosen[usable], places[usable], start[usable], offsets[usable]
    total, plane = total[usable], plane[usable]
    raw = raw[usable] - _planes(plane, raw.shape[1])
    middle = raw[:, inner, inner]
    variances = np.full(len(raw), (0.02 * middle.max() / np.median(total)) ** 2)
    kept = np.ones(len(raw), bool)
    rest = np.zeros_like(middle)
    fine = np.zeros((1, 1))
    for misplaced in rounds:
        samples = _samples(raw, total, offsets, variances, kept)
        fine = fine_psf(samples, _FINER, misplaced)
        fine -= np.median(fine[_border(len(fine), _FINER)])
        scale = fine.sum() / _FINER**2
        if scale <= 0:
            raise InputError("too little light: expose for longer, or use brighter dots")
        fit, rest = _fit(fine / scale, middle, offsets)
        strength = np.maximum(fit[:, 0], 1e-3 * np.median(fit[:, 0]))
        move = np.clip(-fit[:, 1:3] / strength[:, None], -_LARGEST_MOVE_PX, _LARGEST_MOVE_PX)
        offsets = offsets + move
        # What the dots have in common of their moves is a move of the PSF.
        offsets -= (offsets - start)[kept].mean(axis=0)
        noise = np.sqrt((rest**2).mean(axis=(1, 2)))
        usual = np.median(noise)
        far = np.linalg.norm(offsets - start, axis=1) > max(1.0, _FARTHEST_MOVE * grid.spacing_px)
        kept = (noise <= _ODD * usual) & ~far
        # Of all pixels of all windows the middle, which leaves out where the PSF does not fit yet.
        noise_std = 1.4826 * float(np.median(np.abs(rest[kept])))
        variances = (noise_std / total) ** 2
        if kept.sum() < _FEWEST_DOTS:
            raise InputError(
                f"only {kept.sum()} of {len(kept)} dots look alike, at least {_FEWEST_DOTS} are "
                "needed: the grid has to be flat, parallel to the sensor, and of equal dots"
            )
    samples = _samples(raw, total, offsets, variances, kept)
    psf, variance = predict(samples, np.zeros(2), rounds[-1])
    snr = float(np.linalg.norm(psf) / np.sqrt(variance * psf.size))
    if not snr >= _LEAST_SNR:
        raise InputError(
            f"too little light: the signal-to-noise ratio of the PSF is {max(snr, 0):.1f}, at "
            f"least {_LEAST_SNR:g} is needed: expose for longer, or average several pictures"
        )
    rejected = len(grid.positions) + grid.off_grid - int(kept.sum())
    return DotPsf(
        samples,
        rounds[-1],
        snr,
        _field_variation(rest[kept] / total[kept, None, None], places[kept], shape, psf),
        float((offsets - start)[kept].std()),
        grid.spacing_px,
        int(kept.sum()),
        rejected,
        grid.missing,
        dark,
    )


def _check_rim(windows: NDArray[np.float64], spacing_px: float) -> None:
    """Refuse windows that show light where only the background should be.

    Raises
    ------
    InputError
    """
    width = windows.shape[1]
    rim = _border(width, _RING_PX)
    mean = windows.mean(axis=0)
    # On the rim the dots differ by noise only, or by how their neighbours lie.
    noise = windows[:, rim].var(axis=0, ddof=1).mean() / len(windows)
    light = float((mean[rim] ** 2).mean())
    if light > _DETECTION**2 * noise and light > _OVERLAP * float((mean[~rim] ** 2).mean()):
        raise InputError(
            f"the dots overlap: light reaches across windows of {width} px, and the dots are "
            f"{spacing_px:.1f} px apart: use a grid with wider gaps, or check what is said of the "
            "blur"
        )


def _extent(psf: NDArray[np.float64], variance: float) -> float:
    """Return the width in px, about the middle, of what stands out of the noise."""
    steps = np.arange(len(psf)) - len(psf) // 2
    ring = np.maximum(np.abs(steps)[:, None], np.abs(steps)[None, :])
    count = np.bincount(ring.ravel())
    mean = np.bincount(ring.ravel(), psf.ravel()) / count
    seen = mean > np.maximum(_DETECTION * np.sqrt(variance / count), _FAINT * mean.max())
    return float(2 * np.flatnonzero(seen).max(initial=0) + 1)


def _border(width: int, thickness: int = 1) -> NDArray[np.bool_]:
    border = np.ones((width, width), bool)
    border[thickness:-thickness, thickness:-thickness] = False
    return border


def _samples(
    raw: NDArray[np.float64],
    total: NDArray[np.float64],
    offsets: NDArray[np.float64],
    variances: NDArray[np.float64],
    kept: NDArray[np.bool_],
) -> Samples:
    # Divided by all light of a dot, not by the fitted strength: where the PSF is still too smooth,
    # that depends on how a dot lies on the pixels, and dividing by it would keep it too smooth.
    return Samples(raw[kept] / total[kept, None, None], offsets[kept], variances[kept])


def _planes_under(windows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fit a plane to the rim of each window; return level and slopes [N, 3]."""
    width = windows.shape[1]
    rim = _border(width, _RING_PX)
    down, right = np.nonzero(rim)
    terms = np.stack([np.ones(len(down)), down - width // 2, right - width // 2], axis=1)
    return np.asarray(np.linalg.lstsq(terms, windows[:, rim].T, rcond=None)[0].T)


def _planes(plane: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    steps = np.arange(width) - width // 2
    down = plane[:, 1, None, None] * steps[None, :, None]
    right = plane[:, 2, None, None] * steps[None, None, :]
    return np.asarray(plane[:, 0, None, None] + down + right)


def _fit(
    fine: NDArray[np.float64], windows: NDArray[np.float64], offsets: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit the PSF and its slopes to each window; return weights [N, 3] and the rest."""
    count, width, _ = windows.shape
    steps = np.arange(width) - width // 2
    coefficients = ndimage.spline_filter(fine, order=3)
    middle = len(fine) // 2
    slopes = [np.gradient(fine, axis=axis) * _FINER for axis in (0, 1)]
    tables = [coefficients, *(ndimage.spline_filter(slope, order=3) for slope in slopes)]
    weights = np.empty((count, 3))
    rest = np.empty_like(windows)
    down, right = np.meshgrid(steps, steps, indexing="ij")
    for number, (window, offset) in enumerate(zip(windows, offsets, strict=True)):
        at = np.stack([down - offset[0], right - offset[1]]) * _FINER + middle
        terms = [
            ndimage.map_coordinates(table, at, order=3, prefilter=False, mode="nearest").ravel()
            for table in tables
        ]
        matrix = np.stack(terms, axis=1)
        # The ridge keeps a dot without light from moving about.
        weights[number] = np.linalg.lstsq(matrix, window.ravel(), rcond=1e-9)[0]
        rest[number] = window - (matrix @ weights[number]).reshape(width, width)
    return weights, rest


def _field_variation(
    rest: NDArray[np.float64],
    places: NDArray[np.float64],
    shape: tuple[int, ...],
    psf: NDArray[np.float64],
) -> float:
    """Return how much the PSF of a part of the picture differs from that of all, at most."""
    part = np.minimum((places / np.array(shape[:2]) * _PARTS).astype(int), _PARTS - 1)
    number = part[:, 0] * _PARTS + part[:, 1]
    largest = []
    for one in np.unique(number):
        here = rest[number == one]
        if len(here) >= 3:
            mean = here.mean(axis=0)
            noise = here.var(axis=0, ddof=1).mean() / len(here)
            largest.append(max(float((mean**2).sum() - noise * mean.size), 0.0))
    if not largest:
        return float("nan")
    return float(np.sqrt(max(largest)) / np.linalg.norm(psf))
