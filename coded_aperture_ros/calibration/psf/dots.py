"""The PSF of one depth from a photograph of a grid of dots (thesis section 6.3.2)."""

import dataclasses
from functools import partial

import numpy as np
from numpy.typing import NDArray

from coded_aperture_ros.calibration.psf.centre import CentredPsf, centred
from coded_aperture_ros.calibration.psf.fine import (
    FinePsf,
    border_mask,
    centred_steps,
    centroids,
    fit_fine,
    light_extent,
    mask_psf,
)
from coded_aperture_ros.calibration.psf.lattice import find_lattice
from coded_aperture_ros.core.arrays import BoolArray, DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import channel_mean
from coded_aperture_ros.optics import Mask
from coded_aperture_ros.optics.psf import cell_shares

_FEWEST_DOTS = 9
_MOST_MISSING = 0.2
SATURATED = 0.995
# Cells of the fine PSF, a side, and how many of them a pixel may have: fewer for a wide PSF.
_CELLS = 72
_CELLS_PER_PX = (3, 7)
# The first rounds find how wide the PSF is, once its dots lie on each other.
_ROUNDS = (3, 9)
_MASK_ROUNDS = 4
# Pixels beyond the PSF on each side that show how bright the background is.
_RIM_PX = 3
# Light on the rim between dots, over that of the brightest pixel, from which neighbours overlap.
_OVERLAP = 0.1
_LARGEST_MOVE_PX = 0.5
_FARTHEST_PX = 2.0
_SLOPE_STEP_PX = 0.05
# A dot whose difference from the others is larger than usual by this factor shows something else.
_ODD = 4.0
_LEAST_SNR = 5.0
# Parts of the picture, a side, whose PSFs are compared.
_PARTS = 3


@dataclasses.dataclass(frozen=True, eq=False)
class DotPsf:
    """A PSF measured from dots, not yet centred."""

    fine: FinePsf
    width_px: int  # odd; the PSF is not wider
    # Norm of the PSF over that of its noise, from two halves of the dots: its reciprocal is the
    # relative error that noise leaves.
    snr: float
    # Largest relative difference (norm) of the PSF in a ninth of the picture from that of all,
    # without noise. NaN where no ninth has three dots.
    field_variation: float
    spacing_px: float
    # Dots: taken; saturated; unlike the others; not in their places of the grid.
    used: int
    saturated: int
    rejected: int
    missing: int

    def centred(self, mask: Mask | None = None, sign: float | None = None) -> CentredPsf:
        """Centre the PSF in the middle of the mask's extent, and tell its blur size.

        Without the `mask` that is in the lens, the centre of light is the centre. The `sign` of the
        blur size is that of the side of the focus; by default the mask tells, and positive if not.
        Raises `InputError` if the PSF does not look like the mask.
        """
        width = self.width_px + 2
        place, size, misfit = centred(lambda place: self.fine.at(width, place), mask, sign)
        return CentredPsf(self.fine, place, width, size, misfit)


def psf_from_dots(
    picture: NDArray[np.floating], mask: Mask | None = None, sign: float | None = None
) -> DotPsf:
    """Measure the PSF from a picture of a grid of dots, all at one depth.

    The picture, [rows, columns] or [rows, columns, 3], is linear light in [0, 1]: bright dots on a
    dark background. A dot's own width blurs the PSF, so it should be less than half a pixel wide.
    The dots' places and brightnesses, the background under each (a plane), and the PSF that they
    share are fitted in turn. The mask helps to place the dots; `sign` is that of the blur size,
    where the side of the focus is known.

    Raises `InputError` if no grid is found, too many dots are missing or saturated, they overlap,
    or are too dim.
    """
    if not np.isfinite(picture).all():
        raise InputError("has pixels that are NaN or infinite: use linear pictures of a camera")
    grey = channel_mean(picture).astype(np.float64)
    clipped = np.asarray(np.reshape(picture >= SATURATED, (*grey.shape, -1)).any(axis=2))
    lattice = find_lattice(grey)
    if lattice.missing > _MOST_MISSING * (len(lattice.positions) + lattice.missing):
        raise InputError(
            f"{lattice.missing} dots of the grid are missing, {len(lattice.positions)} were found: "
            "cover none, and light all of them"
        )
    room = 2 * int((lattice.spacing_px - 2) // 2) + 1  # the largest odd width without neighbours
    cut = partial(_cut, grey, clipped)
    mean = cut(lattice.positions, room)[0].mean(axis=0)
    _check_gaps(mean, lattice.spacing_px)
    width = min(_extent(mean) + 2 + 2 * _RIM_PX, room)
    windows, places, _ = cut(lattice.positions, width)
    backgrounds = np.median(windows[:, border_mask(width)], axis=1)[:, None, None]
    places = np.rint(places) + _centroids(windows - backgrounds)
    support = width
    for rounds in _ROUNDS:
        width = min(support + 2 * _RIM_PX, room)
        windows, places, saturated = cut(places, width)
        fit = _registered(windows, places - np.rint(places), support, rounds)
        support = min(_extent(fit.fine.at(width)) + 2, width)
        margin = (width - support) // 2
        inside = slice(margin, width - margin)
        offsets = _centroids(fit.light[:, inside, inside])
        if mask is not None:
            offsets = _by_mask(windows, offsets, fit.fine, mask, sign)
        places = np.rint(places) + offsets
    psf = fit.fine.at(width)
    snr = float(np.linalg.norm(psf) / max(fit.noise(width), 1e-12))
    if not snr >= _LEAST_SNR:
        raise InputError(
            f"too little light: the signal-to-noise ratio of the PSF is {snr:.1f}, at least "
            f"{_LEAST_SNR:g} is needed: expose for longer, or average several pictures"
        )
    parts = _field_variation(fit, places, grey.shape)
    return DotPsf(
        fine=fit.fine,
        width_px=support,
        snr=snr,
        field_variation=parts / float(np.linalg.norm(psf)),
        spacing_px=lattice.spacing_px,
        used=int(fit.kept.sum()),
        saturated=saturated,
        rejected=int((~fit.kept).sum()),
        missing=lattice.missing,
    )


def _cut(
    grey: NDArray, clipped: BoolArray, places: NDArray, width: int
) -> tuple[NDArray, NDArray, int]:
    """Return windows of whole dots without saturation, their places, and how many have it."""
    half = width // 2
    centres = np.rint(places).astype(int)
    inside = ((centres >= half) & (centres < np.array(grey.shape) - half)).all(axis=1)
    if inside.sum() < _FEWEST_DOTS:
        raise InputError(
            f"only {inside.sum()} whole dots in the picture, at least {_FEWEST_DOTS} are needed: "
            "use a finer grid, or fill the picture with it"
        )
    steps = np.arange(-half, half + 1)
    rows = centres[inside, 0, None, None] + steps[None, :, None]
    columns = centres[inside, 1, None, None] + steps[None, None, :]
    full = clipped[rows, columns].any(axis=(1, 2))
    if full.sum() > inside.sum() / 2 or (~full).sum() < _FEWEST_DOTS:
        raise InputError(
            f"{full.sum()} of {inside.sum()} dots are saturated: expose for a shorter time"
        )
    return grey[rows, columns][~full], places[inside][~full], int(full.sum())


@dataclasses.dataclass(frozen=True, eq=False)
class _Fit:
    """PSF, dots and what is left [N, k, k] of their windows."""

    fine: FinePsf
    light: DoubleArray
    offsets: DoubleArray
    strengths: DoubleArray
    rest: DoubleArray
    kept: BoolArray
    variance: float

    def of(self, numbers: NDArray[np.int64] | BoolArray) -> FinePsf:
        """Fit the PSF of some of the dots."""
        of_all = self.light, self.offsets, self.strengths
        light, offsets, strengths = (values[numbers] for values in of_all)
        return fit_fine(light, offsets, strengths, self.variance, self.fine)

    def noise(self, width: int) -> float:
        """Return the norm of the PSF's noise, as its two halves differ."""
        used = np.flatnonzero(self.kept)
        halves = [self.of(used[first::2]).at(width) for first in (0, 1)]
        return float(np.linalg.norm(halves[0] - halves[1]) / 2)


def _extent(psf: NDArray) -> int:
    """Return the width in px of what is not faint, over the light on its rim."""
    return light_extent(psf - np.median(psf[border_mask(len(psf))]))


def _check_gaps(mean: NDArray, spacing_px: float) -> None:
    """Refuse dots whose mean window, as wide as their spacing, is lit up to its rim."""
    light = mean - mean.min()
    if (
        light[border_mask(len(mean))].max() > _OVERLAP * light.max()
        or _extent(mean) > len(mean) - 4
    ):
        raise InputError(
            f"the dots overlap: they are {spacing_px:.1f} px apart, and light reaches across the "
            "gaps: use a grid with wider gaps, or less blur"
        )


def _centroids(light: NDArray) -> NDArray:
    """Return the centre of light of each window without background, from its middle [N, 2]."""
    total = light.sum(axis=(1, 2))
    usable = np.maximum(total, max(0.1 * float(np.median(total)), 1e-9))
    farthest = light.shape[1] / 4
    return np.clip(centroids(light) / usable[:, None], -farthest, farthest)


def _by_mask(
    windows: NDArray, offsets: NDArray, fine: FinePsf, mask: Mask, sign: float | None
) -> NDArray:
    """Place the dots by the mask that is about right: what they show, they still tell themselves.

    Centres of light in pixels err with the place on the pixels, by up to 0.05 px where the blur is
    a few px only, and with them a PSF that is fitted to dots so placed.
    """
    width = windows.shape[1]
    _, size, _ = centred(lambda place: fine.at(width, place), mask, sign)
    model = mask_psf(mask, size)
    for _ in range(_MASK_ROUNDS):
        offsets = offsets + _fit_dots(windows, model, offsets)[0]
    return offsets


def _registered(windows: NDArray, offsets: NDArray, support: int, rounds: int) -> _Fit:
    """Fit the PSF, and place, strength and background of every dot, in turn."""
    start = offsets
    width = windows.shape[1]
    rim = windows[:, border_mask(width)]
    backgrounds = np.median(rim, axis=1)[:, None, None]
    strengths = (windows - backgrounds).sum(axis=(1, 2))
    if not np.median(strengths) > 0:
        raise InputError("too little light: expose for longer, or use brighter dots")
    kept = strengths > 0.1 * np.median(strengths)
    light = windows - backgrounds
    finer = int(np.clip(round(_CELLS / support), *_CELLS_PER_PX))
    cells = support * finer
    fine = FinePsf(np.full((cells, cells), 1 / cells**2), 1 / finer)
    fit = _Fit(fine, light, offsets, strengths, windows, kept, float(np.var(rim)))
    for _ in range(rounds):
        fine = fit.of(fit.kept)
        moves, strengths, backgrounds, rest = _fit_dots(windows, fine, fit.offsets)
        offsets = fit.offsets + moves
        # What the dots have in common of their moves is a move of the PSF.
        offsets -= (offsets - start)[fit.kept].mean(axis=0)
        power = (rest**2).mean(axis=(1, 2))
        kept = (power <= _ODD**2 * np.median(power)) & (strengths > 0)
        kept &= np.abs(offsets - start).max(axis=1) <= _FARTHEST_PX
        if kept.sum() < _FEWEST_DOTS:
            raise InputError(
                f"only {kept.sum()} of {len(kept)} dots look alike, at least {_FEWEST_DOTS} are "
                "needed: the grid has to be flat, parallel to the sensor, and of equal dots"
            )
        variance = float(np.median(power[kept]))
        fit = _Fit(fine, windows - backgrounds, offsets, strengths, rest, kept, variance)
    return fit


def _fit_dots(
    windows: NDArray, fine: FinePsf, offsets: NDArray
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Fit moves [N, 2], strengths [N], background planes and rest, by a Gauss-Newton step."""
    width = windows.shape[1]
    cells = len(fine.light)

    def along(axis: int, aside: float = 0.0) -> DoubleArray:
        return cell_shares(width, cells, fine.cell_px, offsets[:, axis] + aside)

    rows = along(0)
    columns = along(1).transpose(0, 2, 1)
    h = _SLOPE_STEP_PX
    row_slopes = (along(0, h) - along(0, -h)) / (2 * h)
    column_slopes = ((along(1, h) - along(1, -h)) / (2 * h)).transpose(0, 2, 1)
    steps = centred_steps(width) / width
    ones = np.ones((len(windows), width, width))
    terms = np.stack(
        [
            rows @ fine.light @ columns,
            row_slopes @ fine.light @ columns,
            rows @ fine.light @ column_slopes,
            ones,
            ones * steps[:, None],
            ones * steps,
        ],
        axis=1,
    ).reshape(len(windows), 6, -1)
    gram = terms @ terms.transpose(0, 2, 1)
    # Keeps a dot without light from moving about.
    gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] / 6 * np.eye(6)
    flat = windows.reshape(len(windows), -1, 1)
    weights = np.linalg.solve(gram, terms @ flat)
    rest = (flat - terms.transpose(0, 2, 1) @ weights).reshape(windows.shape)
    plane = (terms[:, 3:].transpose(0, 2, 1) @ weights[:, 3:]).reshape(windows.shape)
    strengths = weights[:, 0, 0]
    least = 1e-3 * np.median(np.abs(strengths))
    moves = weights[:, 1:3, 0] / np.maximum(strengths, least)[:, None]
    return np.clip(moves, -_LARGEST_MOVE_PX, _LARGEST_MOVE_PX), strengths, plane, rest


def _field_variation(fit: _Fit, places: NDArray, shape: tuple[int, ...]) -> float:
    """Return the norm of the largest mean difference of a part of the picture from the PSF."""
    part = np.minimum((places / np.array(shape) * _PARTS).astype(int), _PARTS - 1)
    number = part @ np.array([_PARTS, 1])
    rest = fit.rest / np.maximum(fit.strengths, 1e-12)[:, None, None]
    powers = []
    for one in np.unique(number):
        here = rest[fit.kept & (number == one)]
        if len(here) >= 3:
            noise = here.var(axis=0, ddof=1).sum() / len(here)
            powers.append(max(float((here.mean(axis=0) ** 2).sum() - noise), 0.0))
    return float(np.sqrt(max(powers))) if powers else float("nan")
