"""Five ways to deconvolve a picture with one PSF, as the methods we compare with do.

All of them take one periodic picture, so that the levels share its transform, and return the
transform of the sharp picture, so that those with a closed form never leave the frequencies.
They are written out where libraries have them too: the treatment of the border, the start and
the strength of the regularisation decide how well levels can be told apart by what is left over.

The strengths follow from the noise. Each was tuned, with the choice of the level at the end, on
photographs that are in no benchmark, for several masks and noises. Their floors are far above
what noise alone asks for: the weaker the regularisation, the further a step in depth is felt.
"""

import dataclasses
from collections.abc import Callable
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.frames import transfer_function
from coded_aperture_ros.likelihood.bank import power_spectrum

_LUCY_ITERATIONS = 6
# Less light, or less than one standard deviation of the noise, counts as that much.
_LUCY_DARKEST = 1e-3


@dataclasses.dataclass(frozen=True)
class Strength:
    """Regularisation that follows from the noise: ``floor + noise^2 / contrast``.

    Attributes
    ----------
    floor : float
        What is left without noise.
    contrast : float
        Variance of the regularised quantity, per frequency, in sharp pictures.
    """

    floor: float
    contrast: float

    def at(self, noise: float) -> np.float32:
        """Return the strength for a standard deviation of the noise."""
        return np.float32(self.floor + noise**2 / self.contrast)


_WIENER = Strength(floor=4e-3, contrast=0.1)
_REGULARIZED = Strength(floor=0.02, contrast=0.02)
_GAUSSIAN = Strength(floor=1e-3, contrast=0.3)
_SPARSE = Strength(floor=3e-4, contrast=0.3)
# Fall-off of the power of photographs with frequency.
_SLOPE = 2.4
_SPARSE_EXPONENT = 0.8
_SMALLEST_POWER = np.float32(1e-9)


@dataclasses.dataclass(frozen=True, eq=False)
class PeriodicPicture:
    """A picture extended so that it repeats without a seam.

    Attributes
    ----------
    extended : ndarray of float32, shape [H, W]
        The picture at the top left; beyond it, its mirror image at one border fades into that at
        the opposite one. `H` and `W` transform fast.
    shape : tuple of int
        Rows and columns of the picture itself.
    """

    extended: NDArray[np.float32]
    shape: tuple[int, int]

    @classmethod
    def of(cls, picture: NDArray[np.float32], border_px: int) -> "PeriodicPicture":
        """Extend a picture [h, w] by at least `border_px` rows and columns."""
        rows = _extended(picture, border_px)
        both = _extended(rows.T, border_px).T
        height, width = picture.shape
        return cls(np.ascontiguousarray(both, np.float32), (height, width))

    @cached_property
    def spectrum(self) -> NDArray[np.complex64]:
        """Transform of the extended picture [H, W // 2 + 1], by ``scipy.fft.rfft2``."""
        return scipy.fft.rfft2(self.extended)

    @cached_property
    def gradient_power(self) -> NDArray[np.float32]:
        """Power that the differences of neighbours pass, both directions [H, W // 2 + 1]."""
        height, width = self.extended.shape
        rows = 2 - 2 * np.cos(2 * np.pi * np.fft.fftfreq(height))
        columns = 2 - 2 * np.cos(2 * np.pi * np.fft.rfftfreq(width))
        return (rows[:, None] + columns).astype(np.float32)

    @cached_property
    def natural_power(self) -> NDArray[np.float32]:
        """Power of photographs of unit variance [H, W // 2 + 1]."""
        height, width = self.extended.shape
        return power_spectrum(_SLOPE, (height, width)).astype(np.float32)

    def back(self, spectrum: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Return the extended picture [H, W] of a transform."""
        return scipy.fft.irfft2(spectrum, self.extended.shape)

    def cropped(self, spectrum: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Return the part of a transform's picture where the picture itself is [h, w]."""
        height, width = self.shape
        return self.back(spectrum)[:height, :width]


def _extended(picture: NDArray[np.float32], border_px: int) -> NDArray[np.float32]:
    height = len(picture)
    extra = scipy.fft.next_fast_len(height + border_px, real=True) - height
    mirrored = np.pad(picture, ((extra, extra), (0, 0)), mode="symmetric")
    above, below = mirrored[:extra], mirrored[height + extra :]
    fade = ((np.arange(extra, dtype=np.float32) + 0.5) / max(extra, 1))[:, None]
    return np.concatenate([picture, below + fade * (above - below)])


Deconvolver = Callable[[PeriodicPicture, NDArray[np.complex64], float], NDArray[np.complex64]]


def wiener(
    picture: PeriodicPicture, transfer: NDArray[np.complex64], noise: float
) -> NDArray[np.complex64]:
    """Wiener filter with one noise-to-signal ratio for all frequencies.

    ``F = conj(H) G / (|H|^2 + r)`` around the picture's mean, which is known.
    """
    sharp = np.conj(transfer) / (_power(transfer) + _WIENER.at(noise)) * picture.spectrum
    sharp[0, 0] = picture.spectrum[0, 0]
    return sharp


def regularized(
    picture: PeriodicPicture, transfer: NDArray[np.complex64], noise: float
) -> NDArray[np.complex64]:
    """Least squares with a penalty on the gradient, the smoothness of thesis 6.3.1.

    ``argmin |g - h * f|^2 + m |grad f|^2``, in closed form. The multiplier ``m`` is in proportion
    to the power of the noise and the same for all levels: one that leaves the noise's power as
    the residual of each level, as is usual for deconvolution alone, would make levels equal.
    """
    penalty = _REGULARIZED.at(noise) * picture.gradient_power
    return np.conj(transfer) / (_power(transfer) + penalty) * picture.spectrum


def gaussian(
    picture: PeriodicPicture, transfer: NDArray[np.complex64], noise: float
) -> NDArray[np.complex64]:
    """Posterior mean with a Gaussian prior of the power spectrum of photographs.

    ``F = conj(H) G / (|H|^2 + r / S)``, the deconvolution with a Gaussian prior of Levin et al.
    (2007) with a power law ``S`` in place of a sum of derivative filters.
    """
    penalty = _GAUSSIAN.at(noise) / picture.natural_power
    sharp = np.conj(transfer) / (_power(transfer) + penalty) * picture.spectrum
    sharp[0, 0] = picture.spectrum[0, 0]
    return sharp


def lucy_richardson(
    picture: PeriodicPicture, transfer: NDArray[np.complex64], noise: float
) -> NDArray[np.complex64]:
    """Iterate a few times as Richardson (1972) and Lucy (1974), from the coded picture.

    Their small number is the regularisation. In each the estimate is multiplied by the blurred
    ratio of the picture to the estimate's own blur. Every estimate is first carried on along its
    last change, as far as the changes agree (Biggs and Andrews 1997). scikit-image has neither
    that nor a start from the picture, and takes the world beyond the border to be black: equally
    many of its iterations take longer and tell levels apart much less well.
    """
    darkest = np.float32(max(_LUCY_DARKEST, noise))
    observed = np.maximum(picture.extended, darkest)
    sharp = observed
    change = last_step = np.zeros_like(observed)
    ahead = np.float32(0)
    for _ in range(_LUCY_ITERATIONS):
        start = np.maximum(sharp + ahead * change, darkest)
        blurred = picture.back(scipy.fft.rfft2(start) * transfer)
        ratio = scipy.fft.rfft2(observed / np.maximum(blurred, darkest))
        updated = np.maximum(start * picture.back(ratio * np.conj(transfer)), darkest)
        step = updated - start
        ahead = np.clip(np.vdot(step, last_step) / max(_squares(last_step), _SMALLEST_POWER), 0, 1)
        sharp, change, last_step = updated, updated - sharp, step
    return scipy.fft.rfft2(sharp)


def levin(
    picture: PeriodicPicture, transfer: NDArray[np.complex64], noise: float
) -> NDArray[np.complex64]:
    """Least squares with the sparse prior of Levin et al. (2007).

    ``argmin |g - h * f|^2 + m |grad f|^0.8`` over both directions of the gradient. Reweighted
    least squares: the penalty becomes ``m |grad f0|^-1.2 |grad f|^2`` at the last estimate
    ``f0``, the first of which is `gaussian`'s, and a few conjugate gradient steps follow. Their
    preconditioner is the inverse for one weight everywhere, which the transform knows.
    """
    power = _power(transfer)
    sharp = sparse_descent(
        picture,
        picture.back(gaussian(picture, transfer, noise)),
        picture.back(np.conj(transfer) * picture.spectrum),
        lambda image: picture.back(power * scipy.fft.rfft2(image)),
        power,
        SparseDescent(_SPARSE.at(noise), np.float32(2e-3), reweightings=2, steps=3),
    )
    return scipy.fft.rfft2(sharp)


@dataclasses.dataclass(frozen=True)
class SparseDescent:
    """How `sparse_descent` goes: the prior's strength, and how far it is followed.

    Attributes
    ----------
    strength : float
        Of the penalty ``|grad f|^0.8``.
    least_gradient : float
        Where the gradient is smaller, its penalty is that of least squares; intensities 0 to 1.
    reweightings, steps : int
        Least squares problems, and conjugate gradient steps on each.
    """

    strength: np.float32
    least_gradient: np.float32
    reweightings: int
    steps: int


def sparse_descent(
    picture: PeriodicPicture,
    sharp: NDArray[np.float32],
    target: NDArray[np.float32],
    normal: Callable[[NDArray[np.float32]], NDArray[np.float32]],
    power: NDArray[np.float32],
    how: SparseDescent,
) -> NDArray[np.float32]:
    """Minimise ``|g - A f|^2 + m sum |grad f|^0.8`` by reweighted least squares.

    Parameters
    ----------
    picture : PeriodicPicture
        Its transform, of [H, W], is what inverts.
    sharp, target : ndarray of float32, shape [H, W]
        The start, and ``A^T g``.
    normal : callable
        Returns ``A^T A f``.
    power : ndarray of float32, shape [H, W // 2 + 1]
        About what ``A^T A`` passes of every frequency, to precondition with.
    how : SparseDescent

    Returns
    -------
    ndarray of float32, shape [H, W]
    """
    for _ in range(how.reweightings):
        penalty = _SparsePenalty.around(sharp, how.strength, how.least_gradient)
        inverse = 1 / (power + penalty.typical * picture.gradient_power + _SMALLEST_POWER)
        residual = target - (normal(sharp) + penalty.gradient(sharp))
        direction = np.zeros_like(sharp)
        before = np.float32(np.inf)
        for _ in range(how.steps):
            preconditioned = picture.back(inverse * scipy.fft.rfft2(residual))
            now = np.vdot(residual, preconditioned)
            if not now > 0:  # A picture without any texture is solved at once.
                break
            direction = preconditioned + (now / before) * direction
            image = normal(direction) + penalty.gradient(direction)
            step = now / np.vdot(direction, image)
            sharp = sharp + step * direction
            residual = residual - step * image
            before = now
    return sharp


@dataclasses.dataclass(frozen=True, eq=False)
class _SparsePenalty:
    """``sum down |df/dy|^2 + across |df/dx|^2`` of a periodic picture; arrays [H, W]."""

    down: NDArray[np.float32]
    across: NDArray[np.float32]

    @classmethod
    def around(
        cls, image: NDArray[np.float32], strength: np.float32, least: np.float32
    ) -> "_SparsePenalty":
        """Weigh squared gradients so that they cost as their sparse penalty does at `image`."""
        down, across = (
            strength
            * np.maximum(np.abs(np.roll(image, -1, axis) - image), least)
            ** np.float32(_SPARSE_EXPONENT - 2)
            for axis in (0, 1)
        )
        return cls(down, across)

    @property
    def typical(self) -> np.float32:
        """One weight in place of all: between their arithmetic and their harmonic mean."""
        return np.sqrt(np.mean(self.down) / np.mean(1 / self.down))

    def gradient(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return half the derivative of the penalty at an image [H, W]."""
        total = np.zeros_like(image)
        for axis, weight in ((0, self.down), (1, self.across)):
            flow = weight * (np.roll(image, -1, axis) - image)
            total += np.roll(flow, 1, axis) - flow
        return total


def _squares(image: NDArray[np.float32]) -> np.float32:
    return np.vdot(image, image)


def _power(transfer: NDArray[np.complex64]) -> NDArray[np.float32]:
    return transfer.real**2 + transfer.imag**2


DECONVOLVERS: dict[str, Deconvolver] = {
    "lucy_richardson": lucy_richardson,
    "regularized": regularized,
    "wiener": wiener,
    "gaussian": gaussian,
    "levin": levin,
}
REFERENCE_METHODS = tuple(DECONVOLVERS)


def check_method(method: str) -> None:
    """Refuse a name that is not one of `REFERENCE_METHODS` with an InputError."""
    if method not in DECONVOLVERS:
        raise InputError(
            f"unknown reference method {method!r}: use one of {', '.join(REFERENCE_METHODS)}"
        )


def deconvolve(
    method: str, picture: NDArray[np.float32], psf: NDArray[np.float32], noise: float
) -> NDArray[np.float32]:
    """Deconvolve a picture with one PSF.

    Parameters
    ----------
    method : str
        One of `REFERENCE_METHODS`.
    picture : ndarray of float32, shape [h, w]
        Grey, linear light, 0 to 1.
    psf : ndarray of float32, shape [k, k]
        Odd, centred, unit sum.
    noise : float
        Standard deviation of the picture's noise.

    Returns
    -------
    ndarray of float32, shape [h, w]
    """
    check_method(method)
    periodic = PeriodicPicture.of(picture, len(psf))
    transfer = transfer_function(psf, periodic.extended.shape)
    return periodic.cropped(DECONVOLVERS[method](periodic, transfer, noise))
