"""Frames that fit their bank, and how they are changed so that they do not."""

import dataclasses
from collections.abc import Callable

import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.optics import PsfStack


@dataclasses.dataclass(frozen=True, eq=False)
class Fitting:
    """A frame that fits: what a camera would record but for its noise, and its PSFs.

    Attributes
    ----------
    light : ndarray, float32 [rows, columns(, 3)]
        Linear light, without noise.
    sharp : callable
        Returns the frame all in focus.
    ordinary : callable
        Returns the frame through an ordinary lens with so many times the extent of the mask.
    stack : PsfStack
        Of the bank.
    blur_size_px : ndarray, float32 [rows, columns]
        Truth; NaN where unknown.
    noise : float
        Standard deviation to be added.
    """

    light: FloatArray
    sharp: Callable[[], FloatArray]
    ordinary: Callable[[float], FloatArray]
    stack: PsfStack
    blur_size_px: FloatArray
    noise: float


@dataclasses.dataclass(frozen=True, eq=False)
class Recorded:
    """What goes into the estimator, and the truth of the frame.

    `known_noise` is what a camera file says of the noise; 0: nothing.
    """

    frame: FloatArray
    stack: PsfStack
    blur_size_px: FloatArray
    known_noise: float = 0.0


# Of frames that fit: share of the light, and times the noise.
FITTING_LIGHT = ((1.0, 1.0), (1.0, 0.5), (1.0, 2.0), (0.5, 1.0), (0.25, 1.0))
Change = Callable[[Fitting, float, np.random.Generator], Recorded | None]


@dataclasses.dataclass(frozen=True)
class Misfit:
    """One kind of misfit.

    Attributes
    ----------
    change : callable
        Makes what is recorded from a fitting frame, a strength from 0 (mild) to 1, and random
        numbers; None where the frame fits all the same.
    causes : tuple of str
        What it may be called.
    traced : bool
        Whether one frame shows it at all.
    """

    change: Change
    causes: tuple[str, ...]
    traced: bool = True


def at_strength(strength: float, *values: float) -> float:
    """Return what belongs to a strength, of values that are equally spaced in it."""
    return float(np.interp(strength, np.linspace(0, 1, len(values)), values))


def step_of(strength: float) -> int:
    """Return which of five things belongs to a strength."""
    return round(4 * strength)


def recorded(fit: Fitting, light: FloatArray, random: np.random.Generator) -> Recorded:
    """Return the frame with noise, clipped to what a sensor records."""
    frame = light + fit.noise * random.standard_normal(light.shape, dtype=np.float32)
    return Recorded(np.clip(frame, 0, 1).astype(np.float32), fit.stack, fit.blur_size_px)


def of_light(change: Callable[[FloatArray, float, np.random.Generator], FloatArray]) -> Change:
    """Change the light before the sensor adds its noise."""

    def changed(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
        return recorded(fit, change(fit.light, strength, random), random)

    return changed


def of_frame(change: Callable[[FloatArray, float, np.random.Generator], FloatArray]) -> Change:
    """Change the frame that the sensor has recorded."""

    def changed(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
        whole = recorded(fit, fit.light, random)
        frame = np.asarray(change(whole.frame, strength, random), np.float32)
        return dataclasses.replace(whole, frame=frame)

    return changed


def of_psfs(change: Callable[[FloatArray, float, float], FloatArray | None]) -> Change:
    """Give the bank PSFs that are not those of the lens."""

    def changed(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded | None:
        stack = fit.stack
        sizes = np.abs(stack.blur_sizes_px)
        psfs = [change(psf, size, strength) for psf, size in zip(stack.psfs, sizes, strict=True)]
        if any(psf is None or not psf.sum() > 0 for psf in psfs):
            return None
        width = max(len(psf) for psf in psfs if psf is not None)
        padded = [np.pad(psf, (width - len(psf)) // 2) for psf in psfs if psf is not None]
        other = np.stack([psf / psf.sum() for psf in padded]).astype(np.float32)
        if other.shape == stack.psfs.shape and np.abs(other - stack.psfs).sum() < 0.1 * len(other):
            return None  # the mask looks the same
        whole = recorded(fit, fit.light, random)
        return dataclasses.replace(whole, stack=dataclasses.replace(stack, psfs=other))

    return changed
