"""PSF of one depth from a photograph of a grid of dots (thesis section 6.3.2)."""

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
from coded_aperture_ros.optics.pixels import cell_shares

_MIN_DOTS = 9
_MAX_MISSING_SHARE = 0.2
_SATURATED = 0.995
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
_MAX_MOVE_PX = 0.5
_MAX_OFFSET_PX = 2.0
_SLOPE_STEP_PX = 0.05
# A dot whose difference from the others is larger than usual by this factor shows something else.
_OUTLIER_FACTOR = 4.0
_MIN_SNR = 5.0
# Parts of the picture, a side, whose PSFs are compared.
_PARTS = 3


@dataclasses.dataclass(frozen=True, eq=False)
class DotPsf:
    """PSF measured from dots, not yet centred."""

    fine: FinePsf
    width_px: int  # odd; the PSF is not wider
    # Norm of the PSF over that of its noise, from two halves of the dots: its reciprocal is the
    # relative error that noise leaves.
    snr: float
    # Largest relative difference (norm) of the PSF in a ninth of the picture from that of all,
    # without noise. NaN where no ninth has three dots.
    field_variation: float
    spacing_px: float
    # Dots: taken; saturated; unlike the others; not in their positions of the grid.
    used: int
    saturated: int
    rejected: int
    missing: int

    def centred(self, mask: Mask | None = None, sign: float | None = None) -> CentredPsf:
        """PSF centred in the middle of the mask's extent, with its blur size.

        Without the `mask` that is in the lens, the centroid of light is the centre. The `sign` of
        the blur size is that of the side of the focus; by default the mask tells, and positive if
        not. Raises `InputError` if the PSF does not look like the mask.
        """
        width = self.width_px + 2
        position, size, misfit = centred(lambda position: self.fine.at(width, position), mask, sign)
        return CentredPsf(self.fine, position, width, size, misfit)


def psf_from_dots(
    picture: NDArray[np.floating], mask: Mask | None = None, sign: float | None = None
) -> DotPsf:
    """PSF from a picture of a grid of dots, all at one depth.

    The dots' positions and brightnesses, the background under each (a plane), and the PSF that they
    share are fitted in turn.

    Parameters
    ----------
    picture : ndarray [rows, columns] or [rows, columns, 3]
        Linear light in [0, 1]: bright dots on a dark background. A dot's own width blurs the PSF,
        so it should be less than half a pixel wide.
    mask : Mask, optional
        Helps to locate the dots.
    sign : float, optional
        Of the blur size, if the side of the focus is known.

    Raises
    ------
    InputError
        If no grid is found, too many dots are missing or saturated, they overlap, or are too dim.
    """
    if not np.isfinite(picture).all():
        raise InputError("has pixels that are NaN or infinite: use linear pictures of a camera")
    grey = channel_mean(picture).astype(np.float64)
    clipped = np.asarray(np.reshape(picture >= _SATURATED, (*grey.shape, -1)).any(axis=2))
    lattice = find_lattice(grey)
    if lattice.missing > _MAX_MISSING_SHARE * (len(lattice.positions) + lattice.missing):
        raise InputError(
            f"{lattice.missing} dots of the grid are missing, {len(lattice.positions)} were found: "
            "cover none, and light all of them"
        )
    room = 2 * int((lattice.spacing_px - 2) // 2) + 1  # the largest odd width without neighbours
    cut = partial(_cut, grey, clipped)
    mean = cut(lattice.positions, room)[0].mean(axis=0)
    _check_gaps(mean, lattice.spacing_px)
    width = min(_extent(mean) + 2 + 2 * _RIM_PX, room)
    windows, positions, _ = cut(lattice.positions, width)
    backgrounds = np.median(windows[:, border_mask(width)], axis=1)[:, None, None]
    positions = np.rint(positions) + _centroids(windows - backgrounds)
    support = width
    for rounds in _ROUNDS:
        width = min(support + 2 * _RIM_PX, room)
        windows, positions, saturated = cut(positions, width)
        fit = _registered(windows, positions - np.rint(positions), support, rounds)
        support = min(_extent(fit.fine.at(width)) + 2, width)
        margin = (width - support) // 2
        inside = slice(margin, width - margin)
        offsets = _centroids(fit.light[:, inside, inside])
        if mask is not None:
            offsets = _mask_offsets(windows, offsets, fit.fine, mask, sign)
        positions = np.rint(positions) + offsets
    psf = fit.fine.at(width)
    snr = float(np.linalg.norm(psf) / max(fit.noise(width), 1e-12))
    if not snr >= _MIN_SNR:
        raise InputError(
            f"too little light: the signal-to-noise ratio of the PSF is {snr:.1f}, at least "
            f"{_MIN_SNR:g} is needed: expose for longer, or average several pictures"
        )
    parts = _field_variation(fit, positions, grey.shape)
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
    grey: NDArray, clipped: BoolArray, positions: NDArray, width: int
) -> tuple[NDArray, NDArray, int]:
    """Windows of whole unsaturated dots, their positions, and the number of saturated ones."""
    half = width // 2
    centres = np.rint(positions).astype(int)
    inside = ((centres >= half) & (centres < np.array(grey.shape) - half)).all(axis=1)
    if inside.sum() < _MIN_DOTS:
        raise InputError(
            f"only {inside.sum()} whole dots in the picture, at least {_MIN_DOTS} are needed: "
            "use a finer grid, or fill the picture with it"
        )
    steps = np.arange(-half, half + 1)
    rows = centres[inside, 0, None, None] + steps[None, :, None]
    columns = centres[inside, 1, None, None] + steps[None, None, :]
    full = clipped[rows, columns].any(axis=(1, 2))
    if full.sum() > inside.sum() / 2 or (~full).sum() < _MIN_DOTS:
        raise InputError(
            f"{full.sum()} of {inside.sum()} dots are saturated: expose for a shorter time"
        )
    return grey[rows, columns][~full], positions[inside][~full], int(full.sum())


@dataclasses.dataclass(frozen=True, eq=False)
class _Fit:
    """PSF, dots and the residual [N, k, k] of their windows."""

    fine: FinePsf
    light: DoubleArray
    offsets: DoubleArray
    strengths: DoubleArray
    rest: DoubleArray
    kept: BoolArray
    variance: float

    def psf_from(self, numbers: NDArray[np.int64] | BoolArray) -> FinePsf:
        """PSF of some of the dots."""
        dots = self.light, self.offsets, self.strengths
        light, offsets, strengths = (values[numbers] for values in dots)
        return fit_fine(light, offsets, strengths, self.variance, self.fine)

    def noise(self, width: int) -> float:
        """Norm of the PSF's noise, from the difference of two halves of the dots."""
        used = np.flatnonzero(self.kept)
        halves = [self.psf_from(used[first::2]).at(width) for first in (0, 1)]
        return float(np.linalg.norm(halves[0] - halves[1]) / 2)


def _extent(psf: NDArray) -> int:
    """Width in px of the light above that on the border."""
    return light_extent(psf - np.median(psf[border_mask(len(psf))]))


def _check_gaps(mean: NDArray, spacing_px: float) -> None:
    """Raise `InputError` if the mean window, as wide as the spacing, is lit up to its border."""
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
    """Centroid of light of each window without background, from its middle [N, 2]."""
    total = light.sum(axis=(1, 2))
    usable = np.maximum(total, max(0.1 * float(np.median(total)), 1e-9))
    farthest = light.shape[1] / 4
    return np.clip(centroids(light) / usable[:, None], -farthest, farthest)


def _mask_offsets(
    windows: NDArray, offsets: NDArray, fine: FinePsf, mask: Mask, sign: float | None
) -> NDArray:
    """Offsets of the dots [N, 2], refined with the rendered PSF of the mask.

    Centroids in pixels err with the position on the pixels, by up to 0.05 px where the blur is a
    few px only, and with them a PSF that is fitted to dots so located.
    """
    width = windows.shape[1]
    _, size, _ = centred(lambda position: fine.at(width, position), mask, sign)
    model = mask_psf(mask, size)
    for _ in range(_MASK_ROUNDS):
        offsets = offsets + _fit_dots(windows, model, offsets)[0]
    return offsets


def _registered(windows: NDArray, offsets: NDArray, support: int, rounds: int) -> _Fit:
    """Fit of the PSF, and of position, strength and background of every dot, in turn."""
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
        fine = fit.psf_from(fit.kept)
        moves, strengths, backgrounds, rest = _fit_dots(windows, fine, fit.offsets)
        offsets = fit.offsets + moves
        # What the dots have in common of their moves is a move of the PSF.
        offsets -= (offsets - start)[fit.kept].mean(axis=0)
        power = (rest**2).mean(axis=(1, 2))
        kept = (power <= _OUTLIER_FACTOR**2 * np.median(power)) & (strengths > 0)
        kept &= np.abs(offsets - start).max(axis=1) <= _MAX_OFFSET_PX
        if kept.sum() < _MIN_DOTS:
            raise InputError(
                f"only {kept.sum()} of {len(kept)} dots look alike, at least {_MIN_DOTS} are "
                "needed: the grid has to be flat, parallel to the sensor, and of equal dots"
            )
        variance = float(np.median(power[kept]))
        fit = _Fit(fine, windows - backgrounds, offsets, strengths, rest, kept, variance)
    return fit


def _fit_dots(
    windows: NDArray, fine: FinePsf, offsets: NDArray
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Moves [N, 2], strengths [N], background planes and residual, by a Gauss-Newton step."""
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
    return np.clip(moves, -_MAX_MOVE_PX, _MAX_MOVE_PX), strengths, plane, rest


def _field_variation(fit: _Fit, positions: NDArray, shape: tuple[int, ...]) -> float:
    """Norm of the largest mean difference of a part of the picture from the PSF."""
    part = np.minimum((positions / np.array(shape) * _PARTS).astype(int), _PARTS - 1)
    number = part @ np.array([_PARTS, 1])
    rest = fit.rest / np.maximum(fit.strengths, 1e-12)[:, None, None]
    powers = []
    for one in np.unique(number):
        here = rest[fit.kept & (number == one)]
        if len(here) >= 3:
            noise = here.var(axis=0, ddof=1).sum() / len(here)
            powers.append(max(float((here.mean(axis=0) ** 2).sum() - noise), 0.0))
    return float(np.sqrt(max(powers))) if powers else float("nan")
