"""A picture of PSFs side by side, for people to look at."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_WIDTH_PX = 120
_GAP_PX = 6
_PER_ROW = 8
_GAP_LIGHT = 0.25


def psf_picture(psfs: Sequence[NDArray[np.floating]]) -> NDArray[np.float32]:
    """Draw PSFs in rows of eight, all at one scale, each up to its own brightest value.

    Parameters
    ----------
    psfs : sequence of ndarray of float, shape [k, k]

    Returns
    -------
    ndarray of float32, shape [rows, columns]
        Linear light, 0 to 1; the gaps are grey.
    """
    width = max(len(psf) for psf in psfs)
    factor = max(1, _WIDTH_PX // width)
    step = width * factor + _GAP_PX
    rows, columns = -(-len(psfs) // _PER_ROW), min(len(psfs), _PER_ROW)
    drawn = np.full((rows * step + _GAP_PX, columns * step + _GAP_PX), _GAP_LIGHT, np.float32)
    for number, psf in enumerate(psfs):
        padded = np.pad(np.maximum(psf, 0), (width - len(psf)) // 2)
        tile = np.kron(padded / max(float(padded.max()), 1e-12), np.ones((factor, factor)))
        top, left = (_GAP_PX + step * place for place in divmod(number, _PER_ROW))
        drawn[top : top + len(tile), left : left + len(tile)] = tile
    return drawn
