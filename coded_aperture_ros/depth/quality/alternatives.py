"""What the lens may be instead: PSFs that are tried beside those of the bank."""

import dataclasses
from functools import lru_cache

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import DoubleArray, FloatArray
from coded_aperture_ros.depth.quality.spectra import WINDOW_PX, Hypotheses
from coded_aperture_ros.optics import Mask, PsfStack, render_psf_stack

# Enough of a bank's levels: more are closer than their spectra differ.
_LEVELS = 16
_SIZES_PX = np.array([2, 3, 4.2, 5.6, 7, 8.6, 10.3, 12.2, 14.3, 16.5, 19, 22])
# Sizes that differ by less are those of the bank.
_BEYOND_PX = 0.7
_SHARP_PX = (0.3, 0.7, 1.1, 1.6)
# An ordinary lens, all in focus, and masks that people use.
_OTHERS = ("disc", "sharp", "levin", "four_hole", "zhou", "mura")
NAMES = ("beyond", "inverted", "rot90", "mirror", "rot45", *_OTHERS)


@dataclasses.dataclass(frozen=True, eq=False)
class Levels:
    """Some PSFs, and their blur sizes, px, without sign."""

    sizes_px: DoubleArray
    psfs: list[FloatArray]

    def with_others(self, other: "Levels") -> "Levels":
        """Return the levels of both, by size."""
        sizes_px = np.concatenate([self.sizes_px, other.sizes_px])
        order, psfs = np.argsort(sizes_px), [*self.psfs, *other.psfs]
        return Levels(sizes_px[order], [psfs[level] for level in order])


def own_levels(stack: PsfStack) -> Levels:
    """Return enough levels of a bank.

    Of a bank for both sides of the focus those of one side: spectra do not tell the sides.
    """
    sizes_px = stack.blur_sizes_px if stack.in_pixels else _widths(stack.psfs)
    longer = np.sign(sizes_px[np.abs(sizes_px).argmax()])
    one_side = np.flatnonzero(sizes_px * longer >= 0)
    count = len(one_side)
    chosen = np.round(np.linspace(0, count - 1, min(count, _LEVELS))).astype(int)
    some = one_side[np.unique(chosen)]
    return Levels(np.abs(sizes_px[some]), [stack.psfs[level] for level in some])


def alternatives(own: Levels) -> dict[str, Hypotheses]:
    """Return what may explain a frame better than the levels of a bank.

    Of `NAMES`, but for what is beyond the bank.
    """
    psfs = own.psfs
    inverted = [_inverted(psf, size) for psf, size in zip(psfs, own.sizes_px, strict=True)]
    made = {
        "inverted": [psf for psf in inverted if psf is not None],
        "rot90": [np.rot90(psf).copy() for psf in psfs],
        "mirror": [psf[:, ::-1] for psf in psfs],
        "rot45": [_turned(psf) for psf in psfs[::2]],
    }
    found = {name: Hypotheses.of(psfs) for name, psfs in made.items() if psfs}
    return found | {name: _other(name) for name in _OTHERS}


@lru_cache
def _other(name: str) -> Hypotheses:
    if name == "sharp":
        rows = [cv2.getGaussianKernel(11, sigma) for sigma in _SHARP_PX]
        return Hypotheses.of([row @ row.T for row in rows])
    return Hypotheses.of(list(render_psf_stack(Mask.named(name), _SIZES_PX).psfs))


def _widths(psfs: FloatArray) -> DoubleArray:
    """Return about how wide PSFs are that do not say [L]: a square's width for their spread."""
    along = np.arange(psfs.shape[-1]) - psfs.shape[-1] // 2
    square = np.add.outer(along**2, along**2)
    spread = np.maximum((psfs * square).sum(axis=(1, 2)) / psfs.sum(axis=(1, 2)), 0)
    return np.asarray(np.sqrt(6 * spread), np.float64)


def levels_beyond(own: Levels) -> Levels:
    """Return the widest of a bank's PSFs at the sizes that it does not have."""
    widest, largest_px = own.psfs[int(own.sizes_px.argmax())], float(own.sizes_px.max())
    if largest_px <= 0:
        return Levels(np.zeros(0), [])
    low, high = own.sizes_px.min() - _BEYOND_PX, largest_px + _BEYOND_PX
    others = [float(size) for size in _SIZES_PX if not low <= size <= high]
    scaled = [(size, _scaled(widest, size / largest_px)) for size in others]
    fitting = [(size, psf) for size, psf in scaled if len(psf) <= WINDOW_PX]
    return Levels(np.array([size for size, _ in fitting]), [psf for _, psf in fitting])


def _scaled(psf: FloatArray, scale: float) -> FloatArray:
    width = int(np.ceil(len(psf) * scale)) // 2 * 2 + 3
    offset = (width - 1) / 2 - scale * (len(psf) - 1) / 2
    if scale < 1:
        psf = cv2.GaussianBlur(psf, (0, 0), max(0.35 * (1 / scale - 0.8), 0.2))
    move = np.array([[scale, 0, offset], [0, scale, offset]])
    scaled = cv2.warpAffine(psf, move, (width, width))
    return np.asarray(scaled / scaled.sum())


def _inverted(psf: FloatArray, size_px: float) -> FloatArray | None:
    """Return the PSF of the mask with open and opaque exchanged; None if that is nothing."""
    along = np.clip(size_px / 2 + 0.5 - np.abs(np.arange(len(psf)) - len(psf) // 2), 0, 1)
    square = np.outer(along, along)
    inverted = np.clip(square - psf / np.quantile(psf[psf > 0], 0.95), 0, 1) * (square > 0)
    share = inverted.sum() / max(square.sum(), 1e-9)
    return np.asarray(inverted / inverted.sum()) if share > 0.05 else None


def _turned(psf: FloatArray) -> FloatArray:
    centre = (len(psf) - 1) / 2
    turn = cv2.getRotationMatrix2D((centre, centre), 45, 1)
    turned = cv2.warpAffine(psf, turn, psf.shape)
    return np.asarray(turned / max(turned.sum(), 1e-9))
