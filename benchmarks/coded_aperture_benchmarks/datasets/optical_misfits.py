"""Frames that do not fit their bank for the lens, the mask, or what moves."""

import dataclasses

import cv2
import numpy as np

from coded_aperture_benchmarks.datasets.fitting_frames import (
    Fitting,
    Misfit,
    Recorded,
    at_strength,
    of_light,
    of_psfs,
    recorded,
    step_of,
)
from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.optics import Mask, PsfStack, render_psf_stack

# How much finer the outline of a changed PSF is drawn than the pixels.
_FINER = 4


def _other_mask(psf: FloatArray, size_px: float, strength: float) -> FloatArray:
    names = ("four_hole", "zhou", "veeraraghavan", "mura", "annulus")
    return render_psf_stack(Mask.named(names[step_of(strength)]), [size_px]).psfs[0]


def _covered(size_px: float, width: int) -> FloatArray:
    """Return the share of every pixel that a square of this size covers."""
    along = np.clip(size_px / 2 + 0.5 - np.abs(np.arange(width) - width // 2), 0, 1)
    return np.outer(along, along).astype(np.float32)


def _inverted(psf: FloatArray, size_px: float, strength: float) -> FloatArray:
    open_part = np.clip(psf / np.quantile(psf[psf > 0], 0.95), 0, 1)
    share = at_strength(strength, 0.35, 0.5, 0.65, 0.8, 1.0)
    return (1 - share) * open_part + share * np.maximum(_covered(size_px, len(psf)) - open_part, 0)


def _margin(psf: FloatArray, size_px: float, strength: float) -> FloatArray:
    wide_px = size_px * at_strength(strength, 1.1, 1.2, 1.3, 1.45, 1.6)
    width = 2 * int(np.ceil(wide_px / 2)) + 1
    pad = max((width - len(psf)) // 2, 0)
    inner = np.pad(psf / np.quantile(psf[psf > 0], 0.95), pad)
    frame = _covered(wide_px, len(inner)) - _covered(size_px, len(inner))
    return inner + np.maximum(frame, 0)


def _turned(psf: FloatArray, size_px: float, strength: float) -> FloatArray:
    centre = (len(psf) - 1) / 2
    turn = cv2.getRotationMatrix2D((centre, centre), at_strength(strength, 6, 12, 20, 45, 90), 1)
    return np.maximum(cv2.warpAffine(psf, turn, psf.shape), 0)


def _mirrored(psf: FloatArray, size_px: float, strength: float) -> FloatArray | None:
    ways = (psf[:, ::-1], psf[::-1], psf.T, None, None)
    return ways[step_of(strength)]


def _blocked(psf: FloatArray, size_px: float, strength: float) -> FloatArray:
    """Cover a corner of the aperture."""
    share = at_strength(strength, 0.3, 0.4, 0.5, 0.6, 0.7)
    along = np.arange(len(psf)) - len(psf) // 2 < size_px * (share - 0.5)
    return np.asarray(psf * ~np.outer(along, along))


def _beyond(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded | None:
    """Leave the bank only levels that the scene does not have."""
    sizes = np.abs(fit.stack.blur_sizes_px)
    low, high = np.nanquantile(np.abs(fit.blur_size_px), [0.02, 0.98])
    away_px = 1 + 4 * strength
    keep = sizes > high + away_px
    if keep.sum() < 8:
        keep = sizes < low - away_px
    if keep.sum() < 8:
        return None
    stack = fit.stack
    depths_m = None if stack.depths_m is None else stack.depths_m[keep]
    some = PsfStack(stack.blur_sizes_px[keep], stack.psfs[keep], depths_m, stack.in_pixels)
    return dataclasses.replace(recorded(fit, fit.light, random), stack=some)


def _no_mask(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
    return recorded(fit, fit.ordinary(at_strength(strength, 0.5, 0.75, 1.0, 1.25, 1.5)), random)


def _sharp(fit: Fitting, strength: float, random: np.random.Generator) -> Recorded:
    sigma_px = at_strength(strength, 0.2, 0.5, 0.8, 1.2, 1.6)
    whole = recorded(fit, cv2.GaussianBlur(fit.sharp(), (0, 0), sigma_px), random)
    return dataclasses.replace(whole, blur_size_px=np.full_like(fit.blur_size_px, 0.3))


def _aberrated(light: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    sigma_px = at_strength(strength, 0.8, 1.2, 1.7, 2.3, 3.0)
    return cv2.GaussianBlur(light, (0, 0), sigmaX=sigma_px, sigmaY=sigma_px / 4)


def _shaken(light: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    length_px, angle = at_strength(strength, 2, 4, 6, 9, 14), random.uniform(0, np.pi)
    side = 2 * int(length_px / 2) + 3
    kernel = np.zeros((_FINER * side,) * 2, np.float32)
    reach = length_px / 2 * _FINER * np.array([np.cos(angle), np.sin(angle)])
    ends = np.rint(_FINER * side / 2 + np.outer([-1, 1], reach)).astype(int)
    cv2.line(kernel, ends[0].tolist(), ends[1].tolist(), 1.0, _FINER)
    kernel = cv2.resize(kernel, (side, side), interpolation=cv2.INTER_AREA)
    return cv2.filter2D(light, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT)


def _doubled(light: FloatArray, strength: float, random: np.random.Generator) -> FloatArray:
    share = at_strength(strength, 0.15, 0.25, 0.35, 0.45, 0.5)
    shift = random.integers(5, 12, 2) * random.choice([-1, 1], 2)
    return (1 - share) * light + share * np.roll(light, shift, (0, 1))


_MASK = ("mask",)
_PATTERN = ("mask", "turned")
# By the name of the kind.
OPTICAL_MISFITS = {
    "other mask": Misfit(of_psfs(_other_mask), _MASK),
    "mask inverted": Misfit(of_psfs(_inverted), _MASK),
    "mask with an open margin": Misfit(of_psfs(_margin), _MASK),
    "part of the mask covered": Misfit(of_psfs(_blocked), _MASK),
    "mask turned": Misfit(of_psfs(_turned), _PATTERN),
    "mask mirrored": Misfit(of_psfs(_mirrored), _PATTERN),
    "no mask": Misfit(_no_mask, ("none",)),
    "all in focus": Misfit(_sharp, ("range",)),
    "out of range": Misfit(_beyond, ("range",)),
    "astigmatism": Misfit(of_light(_aberrated), ("mask", "motion")),
    "shake": Misfit(of_light(_shaken), ("motion",)),
    "double image": Misfit(of_light(_doubled), ("motion", "mask")),
}
