"""Likelihood-ratio test of small changes of a mask: turned a little, or covered in part.

One frame is explained by a bank about as well where its mask is turned by a few degrees, or where a
small part of it is dirty. Over minutes of a moving camera what the texture of single frames says
averages out, and what the mask says adds up; see `depth/drift.py`.
"""

import dataclasses

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.depth.quality.evidence import cut_windows, windows_of_cells
from coded_aperture_ros.depth.quality.spectra import (
    PsfHypotheses,
    PsfLevels,
    bank_levels,
    negative_log_likelihood,
    power_spectra,
)
from coded_aperture_ros.optics import PsfStack

# Rotations that are tried, clockwise, degrees, in order: at 10 px of blur 4 degrees move the
# corners of a mask by half a pixel.
TURNS_DEG = (-12.0, -8.0, -4.0, 4.0, 8.0, 12.0)
# The mask is divided into so many parts along each side; each may be covered.
PARTS = 3
# Least share of the light that the rest has to pass.
_LEAST_REST = 0.2
# Margin on every side that is left out with `middle_only`, as a share of the frame.
_MARGIN_SHARE = 0.3
_FEWEST_WINDOWS = 4
# Most windows along a side of the frame.
_CELLS = 5
# Gains of single windows count up to this, hundredths of the negative log-likelihood.
_MOST_GAIN = 3.0


@dataclasses.dataclass(frozen=True, eq=False)
class MaskLook:
    """What one frame says of the mask.

    Attributes
    ----------
    gains : ndarray, float64 [changes]
        By how much each change of the mask explains the windows better, mean over them, in
        hundredths of the negative log-likelihood per coefficient.
    residual : float
        Logarithm of what the likeliest levels leave of the windows, over the noise, mean over them.
    """

    gains: DoubleArray
    residual: float


class MaskTest:
    """Likelihood-ratio test of small changes of a mask against the mask as its bank has it.

    Attributes
    ----------
    names : tuple of str
        Of the changes: turned by `TURNS_DEG`, then parts covered, by row and column.

    Parameters
    ----------
    stack : PsfStack
        PSFs of the bank, with sizes in px.

    Examples
    --------
    >>> from coded_aperture_ros.optics import Mask, render_psf_stack
    >>> MaskTest(render_psf_stack(Mask.named("levin"), [4.0, 6.0, 8.0])).names[5:7]
    ('turned 12', 'covered 1 1')
    """

    def __init__(self, stack: PsfStack) -> None:
        own = bank_levels(stack)
        changed = _changes(own)
        self.names = tuple(changed)
        self._own = PsfHypotheses.from_psfs(own.psfs)
        self._others = PsfHypotheses.concatenate(
            [PsfHypotheses.from_psfs(psfs) for psfs in changed.values()]
        )

    def look(
        self, grey: FloatArray, noise: float, unusable: BoolArray | None = None
    ) -> MaskLook | None:
        """Evidence of a frame; None if it has too few textured windows.

        Parameters
        ----------
        grey : ndarray, float32 [height, width]
            Linear light, without NaN.
        noise : float
            Its standard deviation, > 0.
        unusable : ndarray, bool [height, width], optional
            Pixels that were filled in.
        """
        tops, lefts, _ = windows_of_cells(grey, unusable, _CELLS)
        if len(tops) < _FEWEST_WINDOWS:
            return None
        power = power_spectra(cut_windows(grey, tops, lefts)) / np.float32(noise**2)
        scores = negative_log_likelihood(power, self._own)
        least = scores.min(axis=(1, 2))
        contrast, kind = np.unravel_index(
            scores.reshape(len(power), -1).argmin(axis=1), scores.shape[1:]
        )
        near = self._others.near_contrasts(contrast.min(), contrast.max())
        others = negative_log_likelihood(power, near)
        best = others.min(axis=1).reshape(len(power), len(self.names), -1).min(axis=2)
        gains = np.clip(100 * (least[:, None] - best), -_MOST_GAIN, _MOST_GAIN)
        residual = least - self._own.log_determinants[contrast, kind]
        return MaskLook(gains.mean(axis=0, dtype=np.float64), float(residual.mean()))


def middle_part(shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Part of a frame for which PSFs of the middle of the image hold."""
    top, left = (int(_MARGIN_SHARE * length) for length in shape[:2])
    return slice(top, shape[0] - top), slice(left, shape[1] - left)


def _changes(own: PsfLevels) -> dict[str, list[FloatArray]]:
    """PSFs of all levels with each change of the mask, by name."""
    changes = {
        f"turned {degrees:g}": [turned(psf, degrees) for psf in own.psfs] for degrees in TURNS_DEG
    }
    for row in range(PARTS):
        for column in range(PARTS):
            psfs = [
                covered(psf, size, row, column)
                for psf, size in zip(own.psfs, own.sizes_px, strict=True)
            ]
            changes[f"covered {row + 1} {column + 1}"] = psfs
    return changes


def turned(psf: FloatArray, degrees: float) -> FloatArray:
    """PSF turned clockwise about its centre; the sum is 1."""
    centre = (len(psf) - 1) / 2
    turn = cv2.getRotationMatrix2D((centre, centre), -degrees, 1)
    other = np.maximum(cv2.warpAffine(psf, turn, psf.shape, flags=cv2.INTER_CUBIC), 0)
    return np.asarray(other / max(other.sum(), 1e-9), np.float32)


def covered(psf: FloatArray, size_px: float, row: int, column: int) -> FloatArray:
    """PSF [k, k] without one of 3 x 3 parts of its mask; itself if too little would be left."""
    along = (np.arange(len(psf)) - len(psf) // 2) / max(size_px, 1e-6) + 0.5
    step = 1 / max(size_px, 1e-6)  # a pixel is covered by its share

    def part(index: int) -> DoubleArray:
        low, high = index / PARTS, (index + 1) / PARTS
        ends = np.minimum(along + step / 2, high) - np.maximum(along - step / 2, low)
        return np.clip(ends / step, 0, 1)

    left = psf * (1 - np.outer(part(row), part(column))).astype(np.float32)
    return np.asarray(left / left.sum() if left.sum() > _LEAST_REST else psf, np.float32)
