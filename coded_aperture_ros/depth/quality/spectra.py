"""Power spectra of windows, and their expected power for a PSF and natural texture."""

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import scipy.fft

from coded_aperture_ros.core.arrays import (
    BoolArray,
    DoubleArray,
    FloatArray,
    IndexArray,
    constant,
    namespace,
)
from coded_aperture_ros.likelihood.bank.fourier import WindowedFourierBasis
from coded_aperture_ros.likelihood.bank.prior import power_spectrum
from coded_aperture_ros.optics import Mask, PsfStack, render_psf_stack
from coded_aperture_ros.optics.nominal import widths_px

WINDOW_PX = 48
_HIGHEST_FREQUENCY = 0.5
# Coarser than in a bank: many PSFs are tried, and the same textures with all of them.
SLOPES = (2.0, 2.8)
_CONTRASTS = 10.0 ** np.arange(6)
OWN_NOISE = 0.02
# Texture is rendered four windows wide; its spectrum is spread by the window's over so many bins.
PERIOD = 4 * WINDOW_PX
_REACH = 10


@dataclasses.dataclass(frozen=True, eq=False)
class Frequencies:
    """The K frequencies of a window that are compared."""

    used: BoolArray  # [rows, columns]; which of ``scipy.fft.rfft2``
    vertical: DoubleArray  # [K]; cycles per pixel
    horizontal: DoubleArray
    share: FloatArray  # [K]; how much of a whole spectrum each stands for; the sum is 1
    window: FloatArray  # [N, N]; Hann window of unit energy

    @property
    def radius(self) -> DoubleArray:
        """Radial frequency, cycles per pixel [K]."""
        return np.asarray(np.hypot(self.vertical, self.horizontal))

    def directions(self, count: int) -> IndexArray:
        """Index of the nearest of `count` directions over half a turn [K]."""
        angle = np.arctan2(self.vertical, self.horizontal) % np.pi
        return (angle / np.pi * count + 0.5).astype(np.intp) % count


@lru_cache(maxsize=1)
def frequencies() -> Frequencies:
    """Frequencies of all spectra of this module."""
    basis = WindowedFourierBasis(WINDOW_PX, _HIGHEST_FREQUENCY)
    n = WINDOW_PX
    multiplicity = basis.multiplicity.reshape(n, -1)
    used = multiplicity > 0
    vertical = np.broadcast_to(np.fft.fftfreq(n)[:, None], used.shape)[used]
    horizontal = np.broadcast_to(np.fft.rfftfreq(n), used.shape)[used]
    counts = multiplicity[used]
    window = np.outer(basis.window, basis.window)
    return Frequencies(used, vertical, horizontal, counts / counts.sum(), window)


def power_spectra(windows: FloatArray) -> FloatArray:
    """Power [n, K] of windows [n, N, N], without their means."""
    at = frequencies()
    xp, used = namespace(windows), constant(np.flatnonzero(at.used), windows)
    centred = windows - windows.mean(axis=(1, 2), keepdims=True)
    fft = scipy.fft if xp is np else xp.fft
    spectra = fft.rfft2(centred * constant(at.window, windows)).reshape(len(windows), -1)[:, used]
    power: FloatArray = spectra.real**2 + spectra.imag**2
    return power


@dataclasses.dataclass(frozen=True, eq=False)
class PsfHypotheses:
    """Expected power of windows for each of P PSFs, texture contrasts and spectral slopes."""

    # [contrasts, P * slopes, K]; inverse of the expected power, in units of the noise, times the
    # frequencies' shares.
    weights: FloatArray
    log_determinants: FloatArray  # [contrasts, P * slopes]; mean logarithm of the expected power

    @classmethod
    def from_psfs(cls, psfs: Sequence[FloatArray]) -> "PsfHypotheses":
        """Hypotheses of P PSFs."""
        return cls.from_power(np.concatenate([_expected_power(psf) for psf in psfs]))

    @classmethod
    def from_power(cls, expected: DoubleArray, noise: DoubleArray | float = 1) -> "PsfHypotheses":
        """Hypotheses of expected power [P * slopes, K] beside that of the noise [K]."""
        share = frequencies().share
        power = _CONTRASTS[:, None, None] * expected + noise
        weights = (share / power).astype(np.float32)
        return cls(weights, (np.log(power) @ share).astype(np.float32))

    @classmethod
    def concatenate(cls, some: Sequence["PsfHypotheses"]) -> "PsfHypotheses":
        """All hypotheses of some groups, one after the other."""
        weights = np.concatenate([each.weights for each in some], axis=1).swapaxes(1, 2)
        determinants = np.concatenate([each.log_determinants for each in some], axis=1)
        # Many are multiplied more quickly with frequencies first in memory.
        return cls(np.ascontiguousarray(weights).swapaxes(1, 2), determinants)

    def near_contrasts(self, lowest: Any, highest: Any) -> "PsfHypotheses":
        """Hypotheses of contrasts from one below an index to one above another.

        Where these are on a device, all contrasts; the others are infinitely unlikely.
        """
        if isinstance(lowest, np.integer):
            some = slice(max(int(lowest) - 1, 0), int(highest) + 2)
            return PsfHypotheses(self.weights[some], self.log_determinants[some])
        every: Any = self.like(lowest)
        index = constant(np.arange(len(self.weights))[:, None], lowest)
        beyond = (index < lowest - 1) | (index > highest + 1)
        return PsfHypotheses(every.weights, every.log_determinants.masked_fill(beyond, np.inf))

    def like(self, array: Any) -> "PsfHypotheses":
        """The same, as tensors on a tensor's device; of an array, itself."""
        weights = constant(self.weights, array)
        return PsfHypotheses(weights, constant(self.log_determinants, array))


def negative_log_likelihood(power: FloatArray, hypotheses: PsfHypotheses) -> FloatArray:
    """Negative log-likelihood of each hypothesis for each window [n, contrasts, P * slopes].

    Twice the negative log-likelihood per coefficient, but for a constant, with a noise of the
    window's own at its best value: the energy of `FilterBank`. `power` [n, K] is in units of the
    noise.
    """
    explained = power @ hypotheses.weights.swapaxes(1, 2)
    explained += OWN_NOISE
    namespace(power).log(explained, out=explained)
    explained += hypotheses.log_determinants[:, None]
    return explained.swapaxes(0, 1)


def _expected_power(psf: FloatArray) -> DoubleArray:
    """Expected power of windows with texture of each slope [slopes, K]."""
    gain = np.abs(scipy.fft.rfft2(psf.astype(np.float64), (PERIOD, PERIOD))) ** 2
    return np.array([window_power(texture * gain) for texture in _textures()])


def window_power(right: DoubleArray) -> DoubleArray:
    """Expected power of windows [K] of a picture with a power spectrum.

    As `WindowedFourierBasis.expected_power` does, but the window's narrow spectrum is convolved
    with, which is a few times as fast and 0.2 % off.
    """
    kernel, margin = _window_spectrum(), _REACH + 2
    # The left half of a spectrum is the right one turned around.
    turned = np.roll(right[::-1], 1, axis=0)
    whole = np.hstack([turned[:, margin:0:-1], right, turned[:, -2 : -margin - 2 : -1]])
    whole = np.vstack([whole[-margin:], whole, whole[:margin]])
    spread = cv2.sepFilter2D(whole, -1, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
    inner = spread[margin:-margin:4, margin : margin + PERIOD // 2 + 1 : 4]
    return np.maximum(inner[frequencies().used], 0)


@lru_cache(maxsize=1)
def _textures() -> list[DoubleArray]:
    return [power_spectrum(slope, (PERIOD, PERIOD)) for slope in SLOPES]


@lru_cache(maxsize=1)
def _window_spectrum() -> DoubleArray:
    window = WindowedFourierBasis(WINDOW_PX).window.astype(np.float64)
    spectrum = np.abs(scipy.fft.fft(window, PERIOD)) ** 2 / PERIOD
    return np.roll(spectrum, _REACH)[: 2 * _REACH + 1]


# Levels of a bank that are tried: so many, as the spectra of more would hardly differ, and all that
# are smaller than this, px.
_LEVELS = 16
_SMALL_PX = 4.0
_SIZES_PX = np.array([2, 3, 4.2, 5.6, 7, 8.6, 10.3, 12.2, 14.3, 16.5, 19, 22])
# Blur sizes within this distance of the bank's are its own, px.
_BEYOND_PX = 0.7
_SHARP_PX = (0.3, 0.7, 1.1, 1.6)
# An open aperture, all in focus, and masks in common use.
_OTHERS = ("disc", "sharp", "levin", "four_hole", "zhou", "mura")
NAMES = ("beyond", "inverted", "rot90", "mirror", "rot45", *_OTHERS)


@dataclasses.dataclass(frozen=True, eq=False)
class PsfLevels:
    """PSFs, and their blur sizes without sign, px."""

    sizes_px: DoubleArray
    psfs: list[FloatArray]

    def with_others(self, other: "PsfLevels") -> "PsfLevels":
        """Levels of both, ordered by size."""
        sizes_px = np.concatenate([self.sizes_px, other.sizes_px])
        order, psfs = np.argsort(sizes_px), [*self.psfs, *other.psfs]
        return PsfLevels(sizes_px[order], [psfs[level] for level in order])


def equivalent_sizes_px(stack: PsfStack) -> DoubleArray:
    """Blur sizes of a stack [L], px; the `widths_px` of its PSFs where it has none."""
    return stack.blur_sizes_px if stack.in_pixels else widths_px(stack.psfs)


def bank_levels(stack: PsfStack) -> PsfLevels:
    """Some levels of a bank, of one side of the focal plane.

    Power spectra do not distinguish the sides.
    """
    sizes_px = equivalent_sizes_px(stack)
    longer = np.sign(sizes_px[np.abs(sizes_px).argmax()])
    one_side = np.flatnonzero(sizes_px * longer >= 0)
    count = len(one_side)
    chosen = np.round(np.linspace(0, count - 1, min(count, _LEVELS))).astype(int)
    small = np.abs(sizes_px[one_side]) < _SMALL_PX
    some = one_side[np.unique([*chosen, *np.flatnonzero(small)])]
    return PsfLevels(np.abs(sizes_px[some]), [stack.psfs[level] for level in some])


def alternatives(own: PsfLevels) -> dict[str, PsfHypotheses]:
    """Hypotheses beside the levels of a bank, by name: those of `NAMES` except "beyond"."""
    psfs = own.psfs
    inverted = [_inverted(psf, size) for psf, size in zip(psfs, own.sizes_px, strict=True)]
    made = {
        "inverted": [psf for psf in inverted if psf is not None],
        "rot90": [np.rot90(psf).copy() for psf in psfs],
        "mirror": [psf[:, ::-1] for psf in psfs],
        "rot45": [_rotated_45(psf) for psf in psfs[::2]],
    }
    found = {name: PsfHypotheses.from_psfs(psfs) for name, psfs in made.items() if psfs}
    return found | {name: _named_alternative(name) for name in _OTHERS}


@lru_cache
def _named_alternative(name: str) -> PsfHypotheses:
    if name == "sharp":
        rows = [cv2.getGaussianKernel(11, sigma) for sigma in _SHARP_PX]
        return PsfHypotheses.from_psfs([row @ row.T for row in rows])
    return PsfHypotheses.from_psfs(list(render_psf_stack(Mask.named(name), _SIZES_PX).psfs))


def levels_beyond(own: PsfLevels) -> PsfLevels:
    """A bank's widest PSF, scaled to the blur sizes that the bank does not have."""
    widest, largest_px = own.psfs[int(own.sizes_px.argmax())], float(own.sizes_px.max())
    if largest_px <= 0:
        return PsfLevels(np.zeros(0), [])
    low, high = own.sizes_px.min() - _BEYOND_PX, largest_px + _BEYOND_PX
    others = [float(size) for size in _SIZES_PX if not low <= size <= high]
    scaled = [(size, _scaled(widest, size / largest_px)) for size in others]
    fitting = [(size, psf) for size, psf in scaled if len(psf) <= WINDOW_PX]
    return PsfLevels(np.array([size for size, _ in fitting]), [psf for _, psf in fitting])


def _scaled(psf: FloatArray, scale: float) -> FloatArray:
    """PSF scaled about its centre, without aliasing; the sum is 1."""
    width = int(np.ceil(len(psf) * scale)) // 2 * 2 + 3
    offset = (width - 1) / 2 - scale * (len(psf) - 1) / 2
    if scale < 1:
        psf = cv2.GaussianBlur(psf, (0, 0), max(0.35 * (1 / scale - 0.8), 0.2))
    move = np.array([[scale, 0, offset], [0, scale, offset]])
    scaled = cv2.warpAffine(psf, move, (width, width))
    return np.asarray(scaled / scaled.sum())


def _inverted(psf: FloatArray, size_px: float) -> FloatArray | None:
    """PSF of the inverted mask (open and opaque exchanged); None if nothing would be open."""
    along = np.clip(size_px / 2 + 0.5 - np.abs(np.arange(len(psf)) - len(psf) // 2), 0, 1)
    square = np.outer(along, along)
    inverted = np.clip(square - psf / np.quantile(psf[psf > 0], 0.95), 0, 1) * (square > 0)
    share = inverted.sum() / max(square.sum(), 1e-9)
    return np.asarray(inverted / inverted.sum()) if share > 0.05 else None


def _rotated_45(psf: FloatArray) -> FloatArray:
    """PSF turned by 45 degrees; the sum is 1."""
    centre = (len(psf) - 1) / 2
    turn = cv2.getRotationMatrix2D((centre, centre), 45, 1)
    turned = cv2.warpAffine(psf, turn, psf.shape)
    return np.asarray(turned / max(turned.sum(), 1e-9))
