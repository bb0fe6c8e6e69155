"""Where light lies in small square pictures of a PSF."""

import numpy as np
from numpy.typing import NDArray

_FAINT = 0.04


def centres_of(pictures: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the first moments of light (down, right) about the middle [..., 2], not divided.

    Pictures are [..., k, k], with odd k.
    """
    steps = steps_of(pictures.shape[-1])
    return np.stack([pictures.sum(axis=-1) @ steps, pictures.sum(axis=-2) @ steps], axis=-1)


def steps_of(width: int) -> NDArray[np.intp]:
    """Return each pixel's distance from the middle one along a side [width]."""
    return np.arange(width) - width // 2


def rim_of(width: int) -> NDArray[np.bool_]:
    """Return which pixels are on the rim [width, width]."""
    return rings_of(width) == width // 2


def rings_of(width: int) -> NDArray[np.intp]:
    """Return the number of the square ring around the middle that each pixel is on."""
    steps = np.abs(steps_of(width))
    return np.maximum(steps[:, None], steps)


def extent_of(light: NDArray[np.floating]) -> int:
    """Return the width in px of what is not faint, about the middle of a picture."""
    return 2 * int(rings_of(len(light))[light > _FAINT * light.max()].max(initial=0)) + 1
