"""The PSF of one depth from a sharp and a coded picture of the same textured plane."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg, ndimage

from coded_aperture_ros.calibration.effective import Model
from coded_aperture_ros.errors import InputError

_SATURATED = 0.995
# Rows of the least squares; more hardly help.
_MOST_PIXELS = 30_000
_BLOCK = 4_000
_FIRST_RIDGE = 1e-6
_EXCHANGES = 30
_LEAST_SNR = 5.0
_LEAST_AGREEMENT = 0.2
_RECENTRINGS = 2
_SHIFT_MARGIN_PX = 32


@dataclasses.dataclass(frozen=True, eq=False)
class PairPsf:
    """A PSF measured from a sharp and a coded picture, not yet centred.

    Attributes
    ----------
    snr : float
        Norm of the PSF over that of its noise.
    agreement : float
        Share of the coded picture's texture (its variance) that the sharp one explains, 0 to 1.
    shift_px : tuple of float
        Down and right: how far the coded picture lies off the sharp one, in whole px.
    """

    sharp: NDArray[np.float64]
    coded: NDArray[np.float64]
    width_px: int
    snr: float
    agreement: float
    shift_px: tuple[int, int]
    _known: dict[tuple[float, ...], tuple[NDArray[np.float64], float]] = dataclasses.field(
        default_factory=dict, repr=False
    )

    def at(
        self, place: NDArray[np.float64], model: Model | None = None
    ) -> tuple[NDArray[np.float64], float]:
        """Return the PSF at whole pixels from a place, and the variance of its values.

        Every place is measured, so that no model is needed.
        """
        key = tuple(np.round(place, 4))
        if key not in self._known:
            moved = _shifted(self.sharp, np.array(key))
            self._known[key] = _solve(moved, self.coded, self.width_px)[:2]
        return self._known[key]


def psf_from_pair(
    sharp: NDArray[np.floating], coded: NDArray[np.floating], largest_blur_px: float
) -> PairPsf:
    """Measure the PSF from two pictures of one textured plane, by non-negative least squares.

    Parameters
    ----------
    sharp : ndarray of float, shape [rows, columns] or [rows, columns, 3]
        Linear light. Taken with a small open aperture in place of the mask, or focused on the
        plane; what blur it has itself is missing from the PSF.
    coded : ndarray of float
        Of the same size, from the same place, with the mask.
    largest_blur_px : float
        The PSF is not wider.

    Returns
    -------
    PairPsf

    Raises
    ------
    InputError
        If sizes differ, pictures are saturated or without texture, too small, or do not show the
        same.
    """
    first, second = (_grey(picture, name) for picture, name in ((sharp, "sharp"), (coded, "coded")))
    if first.shape != second.shape:
        raise InputError(
            f"the coded picture is {_size(second)} px, the sharp one {_size(first)} px: take both "
            "with one camera"
        )
    width = 2 * int(np.ceil(abs(largest_blur_px) / 2 + 2)) + 1
    if min(first.shape) < 4 * width:
        raise InputError(
            f"pictures of {_size(first)} px are too small for a PSF of {width} px: at least "
            f"{4 * width} px a side are needed"
        )
    slopes = first - cv2.blur(first, (3, 3))
    if not slopes.std() > 1e-6:
        raise InputError("the sharp picture has no texture: photograph a printed page")
    second = _evenly_lit(first, second, width)
    shift = _whole_shift(first, second)
    if max(map(abs, shift)) > min(first.shape) // 4:
        raise InputError("sharp and coded picture do not show the same: keep camera and page still")
    one, two = _overlapping(first, second, shift)
    psf, variance, agreement = _solve(one, two, width)
    for _ in range(_RECENTRINGS):
        # The correlation may have taken one hole of the mask for all of it.
        steps = np.arange(width) - width // 2
        off = round(float(psf.sum(axis=1) @ steps)), round(float(psf.sum(axis=0) @ steps))
        if off == (0, 0):
            break
        shift = shift[0] + off[0], shift[1] + off[1]
        one, two = _overlapping(first, second, shift)
        psf, variance, agreement = _solve(one, two, width)
    first, second = one, two
    snr = float(np.linalg.norm(psf) / max(np.sqrt(variance * psf.size), 1e-12))
    if agreement < _LEAST_AGREEMENT or not snr >= _LEAST_SNR:
        raise InputError(
            f"the sharp picture explains {agreement:.0%} of the coded one, with a signal-to-noise "
            f"ratio of {snr:.1f}: both have to show one textured plane, unmoved and well lit"
        )
    return PairPsf(first, second, width, snr, agreement, shift)


def _grey(picture: NDArray[np.floating], name: str) -> NDArray[np.float64]:
    grey = np.asarray(picture, np.float64)
    if not np.isfinite(grey).all():
        raise InputError(f"the {name} picture has pixels that are NaN or infinite")
    if np.mean(grey >= _SATURATED) > 0.01:
        raise InputError(f"the {name} picture is saturated: expose for a shorter time")
    return grey.mean(axis=2) if grey.ndim == 3 else grey


def _size(picture: NDArray) -> str:
    return f"{picture.shape[1]}x{picture.shape[0]}"


def _evenly_lit(
    sharp: NDArray[np.float64], coded: NDArray[np.float64], width: int
) -> NDArray[np.float64]:
    """Return the coded picture with the brightness of the sharp one, on the large scale.

    Its own may differ by exposure and vignetting: a smooth polynomial.
    """
    smooth = [ndimage.gaussian_filter(one, width / 2)[::8, ::8] for one in (sharp, coded)]
    rows, columns = (np.linspace(-1, 1, length) for length in coded.shape)

    def terms(rows: NDArray, columns: NDArray) -> NDArray[np.float64]:
        pairs = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
        return np.stack([np.outer(rows**i, columns**j).ravel() for i, j in pairs], axis=1)

    small = terms(rows[::8], columns[::8]) * smooth[0].ravel()[:, None]
    weights = np.linalg.lstsq(small, smooth[1].ravel(), rcond=None)[0]
    gain = (terms(rows, columns) @ weights).reshape(coded.shape)
    if not gain.min() > 0.02 * gain.max():
        raise InputError("the coded picture is dark: expose for longer")
    return np.asarray(coded / gain)


def _whole_shift(sharp: NDArray[np.float64], coded: NDArray[np.float64]) -> tuple[int, int]:
    """Return how far down and right the coded picture lies, by phase correlation."""
    window = np.outer(*(np.hanning(length) for length in sharp.shape))
    spectra = [fft.rfft2((one - one.mean()) * window) for one in (sharp, coded)]
    cross = np.conj(spectra[0]) * spectra[1]
    # Phases alone find sharp copies; a little of the power keeps what the mask has erased out.
    flat = cross / (np.abs(spectra[0]) ** 2 + 1e-3 * np.mean(np.abs(spectra[0]) ** 2))
    correlation = ndimage.gaussian_filter(fft.irfft2(flat, sharp.shape), 2.0, mode="wrap")
    peak = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    down, right = (
        int(place) - length * (int(place) > length // 2)
        for place, length in zip(peak, correlation.shape, strict=True)
    )
    return down, right


def _overlapping(
    sharp: NDArray[np.float64], coded: NDArray[np.float64], shift: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Cut both pictures to what both show."""
    cut = []
    for sign, picture in ((-1, sharp), (1, coded)):
        ranges = tuple(
            slice(max(0, sign * move), length + min(0, sign * move))
            for move, length in zip(shift, picture.shape, strict=True)
        )
        cut.append(picture[ranges])
    return cut[0], cut[1]


def _shifted(picture: NDArray[np.float64], place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move a picture down and right by less than a pixel, without losing its finest detail."""
    if not np.any(place):
        return picture
    # A Fourier shift takes the picture to repeat: mirrored at its ends, it does so without a step.
    padded = np.pad(picture, _SHIFT_MARGIN_PX, mode="reflect")
    moved = fft.ifft2(ndimage.fourier_shift(fft.fft2(padded), place)).real
    inside = slice(_SHIFT_MARGIN_PX, -_SHIFT_MARGIN_PX)
    return np.asarray(moved[inside, inside])


def _solve(
    sharp: NDArray[np.float64], coded: NDArray[np.float64], width: int
) -> tuple[NDArray[np.float64], float, float]:
    """Return the PSF, the variance of its values, and the share of the texture explained."""
    one, two = _without_background(sharp, width), _without_background(coded, width)
    views = np.lib.stride_tricks.sliding_window_view(one, (width, width))[:, :, ::-1, ::-1]
    reach = width // 2
    target = two[reach:-reach, reach:-reach]
    numbers = np.arange(0, target.size, max(1, target.size // _MOST_PIXELS))
    gram = np.zeros((width**2, width**2))
    right_side = np.zeros(width**2)
    power = 0.0
    for start in range(0, len(numbers), _BLOCK):
        at = np.unravel_index(numbers[start : start + _BLOCK], target.shape)
        block = views[at].reshape(len(at[0]), -1)
        gram += block.T @ block
        right_side += block.T @ target[at]
        power += float((target[at].astype(np.float64) ** 2).sum())
    eye = np.eye(width**2)
    regular = gram + _FIRST_RIDGE * float(np.trace(gram)) / width**2 * eye
    psf = _non_negative(regular, right_side)
    noise = 0.0
    for _ in range(2):
        rest = max(power - 2 * float(psf @ right_side) + float(psf @ gram @ psf), 1e-12 * power)
        noise = rest / max(len(numbers) - width**2, 1)
        # What is most likely, for noise of this variance and values of the PSF's own mean square.
        regular = gram + noise / max(float((psf**2).mean()), 1e-12) * eye
        psf = _non_negative(regular, right_side)
    inverse = np.linalg.inv(regular)
    variance = noise * float(np.einsum("ij,ji->", inverse @ gram, inverse)) / width**2
    total = max(float(psf.sum()), 1e-12)
    rest = power - 2 * float(psf @ right_side) + float(psf @ gram @ psf)
    return psf.reshape(width, width) / total, variance / total**2, 1 - rest / max(power, 1e-30)


def _without_background(picture: NDArray[np.float64], width: int) -> NDArray[np.float32]:
    """Take off what changes more slowly than a PSF is wide: light and background, not texture."""
    return (picture - ndimage.gaussian_filter(picture, width)).astype(np.float32)


def _non_negative(matrix: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Minimise ``x M x / 2 - right x`` over non-negative `x`, by exchanging which values are 0."""
    free = np.ones(len(right), bool)
    x = np.zeros_like(right)
    for _ in range(_EXCHANGES):
        x = np.zeros_like(right)
        x[free] = linalg.solve(matrix[np.ix_(free, free)], right[free], assume_a="pos")
        pull = right - matrix @ x
        exchanged = np.where(free, x >= 0, pull > 0)
        if np.array_equal(exchanged, free):
            break
        free = exchanged
    return np.maximum(x, 0)
