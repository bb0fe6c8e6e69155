"""Where the middle of a measured PSF is, and how wide its mask is in the picture.

Pictures of dots tell a PSF up to a shift: that of the camera's centre of projection, of which
nobody knows where in the lens it lies. The convention of this package is that the middle of the
mask's extent is the centre. With a known mask, the measured PSF is laid over the rendered one.
Without, the widest PSF's outline tells where the openings end, and how that lies about the centre
of its light; the others have the same proportions.
"""

import dataclasses
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coded_aperture_ros.calibration.effective import Model
from coded_aperture_ros.errors import InputError
from coded_aperture_ros.optics import Mask, psf_width, render_psf

_ROUNDS = 8
_SIZE_STEP_PX = 0.05
_CLOSE_PX = 0.01
_SIGNIFICANT = 3.0
_MARGIN_PX = 1
_FINER = 8
# The outline tells the centre to about this, in px: a centre of light as close is the centre.
_OUTLINE_ERROR_PX = 0.15
_PIXEL_VARIANCE = 1 / 12
_LARGEST_MISFIT = 0.5


class PsfAt(Protocol):
    """A PSF that can be asked for at whole pixels from a place (down, right) of its window."""

    def __call__(
        self, place: NDArray[np.float64], model: Model | None = None
    ) -> tuple[NDArray[np.float64], float]:
        """Return values and their variance; `model` is what the PSF is about."""


@dataclasses.dataclass(frozen=True, eq=False)
class CentredPsf:
    """A measured PSF in the package's convention.

    Attributes
    ----------
    psf : ndarray of float64, shape [k, k]
        Odd width, unit sum; the middle of the mask's extent is the middle of the middle pixel.
        What does not stand out of the noise is 0.
    blur_size_px : float
        Signed width of the mask's extent in the picture, as measured; positive without a mask.
    misfit : float
        Relative difference (norm) from the mask's rendered PSF; NaN without a mask.
    snr : float
        Norm of the PSF over that of the noise within it: its reciprocal is the relative error
        that noise leaves.
    """

    psf: NDArray[np.float64]
    blur_size_px: float
    misfit: float
    snr: float


def centred_on_mask(at: PsfAt, mask: Mask, blur_size_px: float | None = None) -> CentredPsf:
    """Centre a PSF by the mask that it is an image of.

    Parameters
    ----------
    at : callable
        The measured PSF at a place; see `PsfAt`.
    mask : Mask
    blur_size_px : float, optional
        Signed, where it is known about; by default both signs are tried.

    Raises
    ------
    InputError
        If the PSF does not look like the mask.
    """
    first = _above_noise(*at(np.zeros(2)))
    if blur_size_px is None:
        spread = _moments(first)[1]
        ratio = _moments(render_psf(mask, 64.0).astype(np.float64))[1] / 64.0
        guess = max(spread / ratio, 1.0)
        fits = [_fitted(at, mask, sign * guess) for sign in (1.0, -1.0)]
    else:
        fits = [_fitted(at, mask, blur_size_px)]
    place, size, misfit = min(fits, key=lambda fit: fit[2])
    if len(fits) == 2 and fits[0][2] < 1.05 * fits[1][2]:
        # A mask that looks the same upside down does not tell the side of the focus.
        place, size, misfit = fits[0]
    if misfit > _LARGEST_MISFIT:
        raise InputError(
            f"the PSF differs from that of mask {mask.name} by {misfit:.0%}: check which mask is "
            "in the lens, its orientation, and the depth"
        )

    def model(from_place: NDArray[np.float64], width: int) -> NDArray[np.float64]:
        down, right = place - from_place
        return render_psf(mask, size, width, (down, right)).astype(np.float64)

    psf, snr = _finished(at, place, size, model)
    return CentredPsf(psf, size, misfit, snr)


def centred_by_outline(measured: Sequence[PsfAt]) -> list[CentredPsf]:
    """Centre PSFs of one unknown mask.

    Raises
    ------
    InputError
        If a PSF has no extent.
    """
    moments = [_moments(_above_noise(*at(np.zeros(2)))) for at in measured]
    widest = int(np.argmax([spread for _, spread in moments]))
    middle, extent = _outline(*measured[widest](np.zeros(2)))
    centroid, spread = moments[widest]
    aside = middle - centroid
    if np.abs(aside).max() < _OUTLINE_ERROR_PX:
        aside = np.zeros(2)
    found = []
    for at, (centre, width) in zip(measured, moments, strict=True):
        size = extent * width / spread
        psf, snr = _finished(at, centre + aside * width / spread, size)
        found.append(CentredPsf(psf, size, np.nan, snr))
    return found


def _fitted(at: PsfAt, mask: Mask, size: float) -> tuple[NDArray[np.float64], float, float]:
    """Return place, blur size and misfit of the mask's PSF that is most like the measured one."""
    width = at(np.zeros(2))[0].shape[0]
    place = _moments(_above_noise(*at(np.zeros(2))))[0]
    place -= _moments(_rendered(mask, size, width))[0]
    misfit = np.inf
    for _ in range(_ROUNDS):
        place = np.clip(place, 2 - width // 2, width // 2 - 2)
        whole = np.rint(place)
        psf = ndimage.shift(at(place - whole)[0], -whole, order=0)
        model = _rendered(mask, size, width)
        wider = _rendered(mask, size + np.copysign(_SIZE_STEP_PX, size), width)
        terms = [model, *np.gradient(model), (wider - model) / _SIZE_STEP_PX]
        matrix = np.stack([term.ravel() for term in terms], axis=1)
        weights = np.linalg.lstsq(matrix, psf.ravel(), rcond=None)[0]
        if weights[0] <= 0:
            return place, size, np.inf
        misfit = float(np.linalg.norm(psf - weights[0] * model) / np.linalg.norm(psf))
        moves = np.clip(weights[1:] / weights[0], -1.0, 1.0)
        place = place - moves[:2]
        size = float(np.copysign(max(abs(size) + moves[2], 0.5), size))
        if np.abs(moves).max() < _CLOSE_PX:
            break
    return place, size, misfit


def _rendered(mask: Mask, size: float, width: int) -> NDArray[np.float64]:
    size = float(np.clip(size, -width, width))
    return render_psf(mask, size, width).astype(np.float64)


def _resized(psf: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Cut or pad a PSF of odd width evenly."""
    margin = (width - len(psf)) // 2
    if margin < 0:
        return psf[-margin:margin, -margin:margin]
    return np.pad(psf, margin)


def _finished(
    at: PsfAt, place: NDArray[np.float64], size: float, model: Model | None = None
) -> tuple[NDArray[np.float64], float]:
    """Return the PSF about a place, cut to its blur size, and its signal-to-noise ratio."""
    whole = np.rint(place)
    psf, variance = at(place - whole, model)
    psf = ndimage.shift(psf, -whole, order=0)
    width = min(psf_width(size) + 2 * _MARGIN_PX, len(psf))
    psf = _resized(psf, width)
    snr = float(np.linalg.norm(psf) / max(np.sqrt(variance * psf.size), 1e-12))
    psf = _above_noise(psf, variance)
    total = psf.sum()
    if not total > 0:
        raise InputError("the PSF has no light: expose for longer")
    return np.asarray(psf / total), snr


def _above_noise(psf: NDArray[np.float64], variance: float) -> NDArray[np.float64]:
    """Return the PSF with 0 wherever noise alone explains the value."""
    return np.where(psf > _SIGNIFICANT * np.sqrt(variance), psf, 0.0)


def _moments(psf: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return the centre of light from the middle, and the spread about it without the pixel's."""
    steps = np.arange(len(psf)) - len(psf) // 2
    shares = [psf.sum(axis=1 - axis) / psf.sum() for axis in (0, 1)]
    centre = np.array([share @ steps for share in shares])
    variance = sum(
        share @ (steps - middle) ** 2 for share, middle in zip(shares, centre, strict=True)
    )
    return centre, float(np.sqrt(max(variance / 2 - _PIXEL_VARIANCE, 1e-6)))


def _outline(psf: NDArray[np.float64], variance: float) -> tuple[NDArray[np.float64], float]:
    """Return the middle of the openings, from the window's, and the width of the wider side.

    An opening ends where its light has fallen to half.
    """
    known = _above_noise(psf, variance)
    plateau = float(np.median(known[known > 0.5 * known.max()]))
    places = np.arange(0, len(psf) - 1 + 0.5 / _FINER, 1 / _FINER)
    middle, extents = np.zeros(2), np.zeros(2)
    for axis in (0, 1):
        profile = np.interp(places, np.arange(len(psf)), known.max(axis=1 - axis))
        light = np.flatnonzero(profile >= plateau / 2)
        first, last = places[light[0]], places[light[-1]]
        middle[axis] = (first + last) / 2 - len(psf) // 2
        extents[axis] = last - first + 1 / _FINER
    return middle, float(extents.max())
