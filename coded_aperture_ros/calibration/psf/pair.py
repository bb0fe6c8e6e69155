"""The PSF of one depth from a sharp and a coded picture of the same textured plane."""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg, ndimage, optimize

from coded_aperture_ros.calibration.psf.centre import PHASES, CentredPsf, centred, check_misfit
from coded_aperture_ros.calibration.psf.dots import SATURATED
from coded_aperture_ros.calibration.psf.fine import FinePsf, centroids, light_extent
from coded_aperture_ros.core.arrays import DoubleArray
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import channel_mean
from coded_aperture_ros.optics import Mask, render_psf

_MOST_SATURATED = 0.01
# Rows of the least squares; more hardly help.
_MOST_PIXELS = 30_000
_BLOCK = 4_000
_EXCHANGES = 30
_LEAST_SNR = 5.0
_LEAST_EXPLAINED = 0.2
_RECENTRINGS = 3
_SHIFT_MARGIN_PX = 32
# Side of the part of the pictures by which they are registered.
_REGISTERED_PX = 256


@dataclasses.dataclass(frozen=True, eq=False)
class PairPsf:
    """A PSF measured from a sharp and a coded picture, not yet centred."""

    # [rows, columns]; what both pictures show, evenly lit.
    sharp: DoubleArray
    coded: DoubleArray
    width_px: int  # odd; the PSF is not wider
    snr: float  # norm of the PSF over that of its noise
    # Share of the coded picture's texture (its variance) that the sharp one explains, 0 to 1.
    explained: float
    shift_px: tuple[int, int]  # down and right: how far the coded picture lies off the sharp one

    def at(self, place: DoubleArray) -> DoubleArray:
        """Return the PSF at whole pixels, its origin moved by `place` (down, right), in px."""
        return _solve(_moved(self.sharp, -place), self.coded, self.width_px)[0]

    def centred(self, mask: Mask | None = None, sign: float | None = None) -> CentredPsf:
        """See `DotPsf.centred`."""
        width = self.width_px
        if mask is None:
            place, size, misfit = centred(self.at, phases=PHASES[:1])
            return CentredPsf(FinePsf(self.at(place), 1.0), np.zeros(2), width, size, misfit)
        place, size = self._like_mask(mask, sign)
        psf = self.at(place)
        misfit = float(np.linalg.norm(psf - render_psf(mask, size, width)) / np.linalg.norm(psf))
        check_misfit(misfit, mask)
        return CentredPsf(FinePsf(psf, 1.0), np.zeros(2), width, size, misfit)

    def _like_mask(self, mask: Mask, sign: float | None) -> tuple[NDArray, float]:
        """Return the place (see `at`) and the blur size for which the mask explains most.

        Place and size are compared with the pictures themselves: between two places on the pixels,
        a PSF that was solved for is not what the mask's would be.
        """
        middle = tuple(
            slice((length - min(length, _REGISTERED_PX)) // 2, (length + _REGISTERED_PX) // 2)
            for length in self.sharp.shape
        )
        first, second = (_textured(one[middle], self.width_px) for one in (self.sharp, self.coded))
        spectrum = fft.rfft2(first)
        inside = slice(self.width_px, -self.width_px)
        target = second[inside, inside]
        centre = centroids(self.at(np.zeros(2)))

        def rest(x: DoubleArray) -> float:
            psf = np.zeros(first.shape)
            size = float(np.copysign(np.clip(abs(x[2]), 1.0, self.width_px), x[2]))
            psf[: self.width_px, : self.width_px] = render_psf(mask, size, self.width_px)
            move = x[:2] - self.width_px // 2
            moved = ndimage.fourier_shift(fft.rfft2(psf) * spectrum, move, n=first.shape[1])
            seen = fft.irfft2(moved, first.shape)[inside, inside]
            return float(np.linalg.norm(target - seen * (seen * target).sum() / (seen**2).sum()))

        sides = (1.0, -1.0) if sign is None else (float(np.sign(sign)),)
        sizes = np.arange(2.0, self.width_px, 1.0)
        starts = [np.array([*centre, side * size]) for side in sides for size in sizes]
        # The sizes nearest to the best one may each lead to another minimum.
        best = sorted(starts, key=rest)[:2]
        fits = [optimize.minimize(rest, x, method="Nelder-Mead", tol=3e-3) for x in best]
        found = min(fits, key=lambda fit: float(fit.fun)).x
        return -found[:2], float(found[2])


def psf_from_pair(
    sharp: NDArray[np.floating], coded: NDArray[np.floating], largest_blur_px: float = 31.0
) -> PairPsf:
    """Measure the PSF from two pictures of one textured plane, by non-negative least squares.

    Both are linear light, [rows, columns] or [rows, columns, 3], of one size, from the same place.
    The sharp one is taken with a small open aperture in place of the mask, or focused on the plane;
    what blur it has itself is missing from the PSF. The coded one, with the mask, may lie off the
    sharp one, and have another brightness that changes slowly over the picture. The PSF is not
    wider than `largest_blur_px`.

    Raises `InputError` if sizes differ, pictures are saturated or without texture, too small, or do
    not show the same.
    """
    one, two = _grey(sharp, "sharp"), _grey(coded, "coded")
    if one.shape != two.shape:
        raise InputError(
            f"the coded picture has {two.shape[1]}x{two.shape[0]} px, the sharp one "
            f"{one.shape[1]}x{one.shape[0]} px: take both with one camera"
        )
    width = 2 * int(np.ceil(largest_blur_px / 2 + 1)) + 1
    if min(one.shape) < 4 * width:
        raise InputError(
            f"{one.shape[1]}x{one.shape[0]} px are too few for a PSF of {width} px: at least "
            f"{4 * width} px a side are needed"
        )
    if not (one - ndimage.uniform_filter(one, 3)).std() > 1e-6:
        raise InputError("the sharp picture has no texture: photograph a printed page")
    two = _evenly_lit(one, two, width)
    shift = _whole_shift(one, two)
    for _ in range(_RECENTRINGS):
        if max(map(abs, shift)) > min(one.shape) // 4:
            raise InputError("the pictures do not show the same: keep camera and page still")
        first, second = _overlapping(one, two, shift)
        psf, variance, explained = _solve(first, second, width)
        snr = float(np.linalg.norm(psf) / max(np.sqrt(variance * psf.size), 1e-12))
        # The correlation may have taken one hole of the mask for all of it.
        down, right = np.rint(centroids(psf)).astype(int).tolist()
        if (down, right) == (0, 0):
            break
        shift = shift[0] + down, shift[1] + right
    if explained < _LEAST_EXPLAINED or not snr >= _LEAST_SNR:
        raise InputError(
            f"the sharp picture explains {explained:.0%} of the coded one, with a signal-to-noise "
            f"ratio of {snr:.1f}: both have to show one textured plane, unmoved and well lit"
        )
    # What is narrower than it could be is solved for with fewer unknowns, and less noise.
    narrow = min(light_extent(psf) + 4, width)
    return PairPsf(first, second, narrow, snr, explained, shift)


def _grey(picture: NDArray[np.floating], name: str) -> NDArray:
    if not np.isfinite(picture).all():
        raise InputError(f"the {name} picture has pixels that are NaN or infinite")
    if np.mean(picture >= SATURATED) > _MOST_SATURATED:
        raise InputError(f"the {name} picture is saturated: expose for a shorter time")
    return channel_mean(picture).astype(np.float64)


def _evenly_lit(sharp: NDArray, coded: NDArray, width: int) -> NDArray:
    """Return the coded picture lit as the sharp one, up to a smooth polynomial."""
    smooth = [ndimage.gaussian_filter(one, width / 2)[::8, ::8] for one in (sharp, coded)]
    rows, columns = (np.linspace(-1, 1, length) for length in coded.shape)

    def terms(rows: NDArray, columns: NDArray) -> DoubleArray:
        powers = [(p, q) for p in range(4) for q in range(4 - p)]
        return np.stack([np.outer(rows**p, columns**q).ravel() for p, q in powers], axis=1)

    small = terms(rows[::8], columns[::8]) * smooth[0].ravel()[:, None]
    weights = np.linalg.lstsq(small, smooth[1].ravel(), rcond=None)[0]
    gain = (terms(rows, columns) @ weights).reshape(coded.shape)
    if not gain.min() > 0.02 * gain.max():
        raise InputError("the coded picture is dark: expose for longer")
    return np.asarray(coded / gain)


def _whole_shift(sharp: NDArray, coded: NDArray) -> tuple[int, int]:
    """Return how far down and right the coded picture lies, by phase correlation."""
    window = np.outer(*(np.hanning(length) for length in sharp.shape))
    spectra = [fft.rfft2((one - one.mean()) * window) for one in (sharp, coded)]
    power = np.abs(spectra[0]) ** 2
    # Phases alone find sharp copies; a little of the power keeps what the mask has erased out.
    flat = np.conj(spectra[0]) * spectra[1] / (power + 1e-3 * power.mean())
    correlation = ndimage.gaussian_filter(fft.irfft2(flat, sharp.shape), 2.0, mode="wrap")
    peak = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    down, right = (
        int(place) - length * (int(place) > length // 2)
        for place, length in zip(peak, correlation.shape, strict=True)
    )
    return down, right


def _overlapping(sharp: NDArray, coded: NDArray, shift: tuple[int, int]) -> tuple[NDArray, NDArray]:
    """Cut both pictures to what both show."""

    def cut(picture: DoubleArray, sign: int) -> DoubleArray:
        down, right = (
            slice(max(0, sign * move), length + min(0, sign * move))
            for move, length in zip(shift, picture.shape, strict=True)
        )
        return picture[down, right]

    return cut(sharp, -1), cut(coded, 1)


def _moved(picture: NDArray, move: NDArray) -> NDArray:
    """Move a picture down and right by about a pixel, without losing its finest detail."""
    # A Fourier shift takes the picture to repeat: mirrored at its ends, it does so without a step.
    padded = np.pad(picture, _SHIFT_MARGIN_PX, mode="reflect")
    moved = fft.ifft2(ndimage.fourier_shift(fft.fft2(padded), move)).real
    inside = slice(_SHIFT_MARGIN_PX, -_SHIFT_MARGIN_PX)
    return np.asarray(moved[inside, inside])


def _textured(picture: NDArray, width: int) -> NDArray:
    """Take off what changes more slowly than a PSF is wide: light and background."""
    return np.asarray(picture - ndimage.gaussian_filter(picture, width))


def _solve(sharp: NDArray, coded: NDArray, width: int) -> tuple[NDArray, float, float]:
    """Return the PSF, the variance of its values, and the share of the texture explained."""
    one, two = (_textured(part, width).astype(np.float32) for part in (sharp, coded))
    views = np.lib.stride_tricks.sliding_window_view(one, (width, width))[:, :, ::-1, ::-1]
    target = two[width // 2 : -(width // 2), width // 2 : -(width // 2)]
    numbers = np.arange(0, target.size, max(1, target.size // _MOST_PIXELS))
    gram, right_side, power = np.zeros((width**2, width**2)), np.zeros(width**2), 0.0
    for first in range(0, len(numbers), _BLOCK):
        at = np.unravel_index(numbers[first : first + _BLOCK], target.shape)
        block = views[at].reshape(len(at[0]), -1)
        gram += block.T @ block
        right_side += block.T @ target[at]
        power += float((target[at].astype(np.float64) ** 2).sum())
    scale = float(np.trace(gram)) / width**2
    regular, noise, rest = gram + 1e-6 * scale * np.eye(width**2), 0.0, power
    for _ in range(3):
        psf = _non_negative(regular, right_side)
        rest = max(power - 2 * float(psf @ right_side) + float(psf @ gram @ psf), 1e-12 * power)
        noise = rest / max(len(numbers) - width**2, 1)
        # What is most likely, for noise of this variance and values of the PSF's own mean square.
        regular = gram + noise / max(float((psf**2).mean()), 1e-12) * np.eye(width**2)
    inverse = np.linalg.inv(regular)
    variance = noise * float(np.einsum("ij,ji->", inverse @ gram, inverse)) / width**2
    total = max(float(psf.sum()), 1e-12)
    return psf.reshape(width, width) / total, variance / total**2, 1 - rest / max(power, 1e-30)


def _non_negative(matrix: NDArray, right: NDArray) -> NDArray:
    """Minimise ``x M x / 2 - right x`` over non-negative `x`, by exchanging which values are 0."""
    free = np.ones(len(right), bool)
    x = np.zeros_like(right)
    for _ in range(_EXCHANGES):
        x = np.zeros_like(right)
        x[free] = linalg.solve(matrix[np.ix_(free, free)], right[free], assume_a="pos")
        exchanged = np.where(free, x >= 0, right - matrix @ x > 0)
        if np.array_equal(exchanged, free):
            break
        free = exchanged
    return np.maximum(x, 0)
