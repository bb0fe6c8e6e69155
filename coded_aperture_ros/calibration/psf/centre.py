"""Middle and width of the mask's extent in a measured PSF.

Dots tell a PSF up to a shift. In a PSF stack, the middle of the mask's extent is the centre. With a
known mask, its rendered PSF is laid over the measured one. Without, the centroid of light is used:
the same for a mask that looks the same turned by 180 degrees; for another one, all-in-focus frames
are shifted in proportion to the blur, and depth is not affected.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from coded_aperture_ros.calibration.psf.fine import FinePsf, centred_steps, centroids, mask_psf
from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.optics import Mask, psf_width

# What a PSF is at whole pixels, its origin at a place (down, right) from their middle.
PsfAt = Callable[[DoubleArray], DoubleArray]

_ROUNDS = 4
_CLOSE_PX = 1e-3
_MAX_MISFIT = 0.5
_PIXEL_VARIANCE = 1 / 12
# Dots are compared at several places on the pixels: at one, two blur sizes may look the same.
_PHASES = np.array([(0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5)])
_LARGE_PX = 63.0
_GUESSES = np.linspace(0.7, 1.4, 15)
# How much better a turned mask has to fit to be taken.
_TURNED = 0.95


@dataclasses.dataclass(frozen=True, eq=False)
class CentredPsf:
    """Measured PSF with known middle and width."""

    fine: FinePsf
    # [2]; where its origin has to be (down, right), in px, so that the mask's extent is centred.
    place: DoubleArray
    width_px: int  # odd; it is not wider
    # Signed width of the mask's extent. Without a mask, that of an even square with the same
    # spread, positive: right in proportion.
    blur_size_px: float
    misfit: float  # relative difference (norm) from the mask's rendered PSF; NaN without a mask

    def psf(self, width: int, scale: float = 1.0) -> DoubleArray:
        """PSF of pictures [width, width], `scale` times as wide as measured."""
        return finished(self.fine.interpolated(width, self.place * scale, scale))


def centred(
    at: PsfAt, mask: Mask | None = None, sign: float | None = None
) -> tuple[DoubleArray, float, float]:
    """Middle, blur size and misfit of a measured PSF; `at` returns the PSF at a position.

    See `CentredPsf`, and `DotPsf.centred` for the other arguments.
    """
    place = np.zeros(2)
    size = 0.0
    misfit = np.nan
    for _ in range(_ROUNDS):
        psfs = np.stack([at(place + phase) for phase in _PHASES])
        centres, spreads = zip(*(_moments(psf) for psf in psfs), strict=True)
        # The centre of light in pixels errs with the place on them; over half a pixel, it cancels.
        move = np.mean(centres - _PHASES, axis=0)
        spread = float(np.mean(spreads))
        if mask is None:
            size = max(float(np.sqrt(12)) * spread, 1.0)
        else:
            misfit, size, move = _best_mask_fit(psfs, move, spread, mask, sign)
            sign = size  # the side of the focus that was found first stays
        place = place - move
        if np.abs(move).max() < _CLOSE_PX:
            break
    if mask is not None and not misfit <= _MAX_MISFIT:
        raise InputError(
            f"the PSF differs from that of mask {mask.name} by {misfit:.0%}: check which mask is "
            "in the lens, and its orientation"
        )
    return place, size, misfit


def _best_mask_fit(
    psfs: NDArray, centroid: NDArray, spread: float, mask: Mask, sign: float | None
) -> tuple[float, float, NDArray]:
    """Misfit, blur size and middle of the mask's PSF that is most like the measured one."""
    width = psfs.shape[1]
    flat = psfs.ravel()
    aside, mask_spread = _moments(mask_psf(mask, _LARGE_PX).at(psf_width(_LARGE_PX)))

    def difference(x: DoubleArray) -> DoubleArray:
        fine = mask_psf(mask, x[2])
        model = np.stack([fine.at(width, x[:2] + phase) for phase in _PHASES]).ravel()
        return np.asarray(flat - model * (flat @ model) / (model @ model))

    fits = []
    for side in (1.0, -1.0) if sign is None else (float(np.sign(sign)),):
        sizes = side * np.clip(spread * _LARGE_PX / mask_spread * _GUESSES, 1.0, width)
        starts = [np.array([*(centroid - aside * size / _LARGE_PX), size]) for size in sizes]
        start = min(starts, key=lambda x: float(np.linalg.norm(difference(x))))
        fit = optimize.least_squares(difference, start, method="lm", diff_step=1e-3)
        misfit = float(np.sqrt(2 * fit.cost) / np.linalg.norm(flat))
        # A mask that looks the same turned does not tell the side: positive then.
        fits.append((misfit * (_TURNED if side > 0 else 1.0), misfit, fit.x))
    _, misfit, found = min(fits, key=lambda fit: fit[0])
    return misfit, float(found[2]), found[:2]


def _moments(psf: NDArray) -> tuple[NDArray, float]:
    """Centroid of light from the middle, and the spread about it without the pixel's."""
    centre = centroids(psf) / psf.sum()
    steps = centred_steps(len(psf))
    shares = [psf.sum(axis=axis) / psf.sum() for axis in (1, 0)]
    variances = [share @ (steps - c) ** 2 for share, c in zip(shares, centre, strict=True)]
    return centre, float(np.sqrt(max(np.mean(variances) - _PIXEL_VARIANCE, 1e-4)))


def finished(psf: DoubleArray) -> DoubleArray:
    """Nearest PSF that is nowhere negative and has unit sum.

    Setting negative values to 0 alone would leave the positive half of the noise, and too large a
    sum: here all values are lowered by what the sum requires, none below 0.
    """
    values = np.sort(psf.ravel())[::-1]
    lowered = (np.cumsum(values) - 1) / np.arange(1, values.size + 1)
    last = np.flatnonzero(values > lowered)[-1]
    return np.maximum(psf - lowered[last], 0)
