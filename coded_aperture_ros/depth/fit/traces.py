"""What files, sensors and drivers leave in a frame besides blur and noise."""

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import FloatArray
from coded_aperture_ros.imaging.noise import ALTERNATING, HALF_AS_FAST

_USUAL_NOISE = 2e-3
_NOISE_PX, _LEAST = 24, 2e-5
_BLOCKS_PX = (8, 16)
_CLIPPED = 0.985


def traces(grey: FloatArray, noise: float, known: float) -> list[float]:
    """Return numbers about a frame [rows, columns] that do not depend on the mask.

    Parameters
    ----------
    noise : float
        Standard deviation that is reckoned with.
    known : float
        What was known of it beforehand; 0: nothing.
    """
    return [
        *_noise(grey, noise, known),
        *_block_grid(grey, noise),
        *_values(grey),
        *_lines(grey, noise),
        _mosaic(grey),
        _lonely(grey, noise),
    ]


def _noise(grey: FloatArray, noise: float, known: float) -> list[float]:
    """Return its colour, its size, and how that compares with what was known."""
    found = []
    for kernel in (ALTERNATING, HALF_AS_FAST):
        square = cv2.sepFilter2D(grey, -1, kernel, kernel) ** 2
        around = cv2.boxFilter(square, -1, (_NOISE_PX, _NOISE_PX))
        half = _NOISE_PX // 2
        some = np.sqrt(np.maximum(around[half:-half:half, half:-half:half], 0))
        found += list(np.quantile(some, (0.05, 0.5)) + _LEAST)
    high, high_median, half_high, half_median = found
    unlike = np.log(high / known) if known else 0.0
    return [
        np.log(high / half_high),
        np.log(high_median / half_median),
        np.log(high / _USUAL_NOISE),
        np.log(noise / _USUAL_NOISE),
        unlike,
        abs(unlike),
        float(known > 0),
    ]


def _block_grid(grey: FloatArray, noise: float) -> list[float]:
    """Return how much more neighbours differ at one place in 8, and in 16, than at the others."""
    found = []
    for axis, some in enumerate((grey[:, ::2], grey[::2])):
        steps = np.abs(np.diff(some, axis=axis))
        steps = np.minimum(steps, 4 * noise + np.quantile(steps[::3, ::3], 0.5))
        profile = steps.mean(1 - axis)
        for block in _BLOCKS_PX:
            phases = profile[: len(profile) // block * block].reshape(-1, block).mean(0)
            found.append(np.log(max(phases.max(), 1e-9) / max(np.median(phases), 1e-9)))
    return found


def _values(grey: FloatArray) -> list[float]:
    """Return how many pixels are alike, clipped or black, and how many values there are."""
    rows, some = grey[::2], grey[::3, ::3]
    steps = np.abs(np.diff(rows, axis=1))
    values = np.count_nonzero(np.bincount((np.clip(some.ravel(), 0, 2) * 65535 + 0.5).astype(int)))
    brightest = float(grey.max())
    return [
        float((steps < 1e-7).mean()),
        float((steps < 2e-4).mean()),
        float((rows > _CLIPPED).mean()),
        float((rows > 0.9 * brightest).mean()),
        brightest,
        np.log(max(float(grey.mean()), 0) + 1e-3),
        float((rows <= 1e-6).mean()),
        np.log(values / some.size),
    ]


def _lines(grey: FloatArray, noise: float) -> list[float]:
    """Return how uneven rows and columns are, beside what noise makes of them."""
    found = []
    for axis in (0, 1):
        line = grey.mean(1 - axis)
        uneven = np.abs(line[2:] - 2 * line[1:-1] + line[:-2]).mean()
        found.append(np.log(uneven * np.sqrt(grey.shape[1 - axis]) / noise + 1e-3))
    return found


def _mosaic(grey: FloatArray) -> float:
    """Return how much the four places of every square of two by two pixels differ."""
    means = [grey[row::2, column::2].mean() for row in (0, 1) for column in (0, 1)]
    return float(np.log(1e-4 + np.std(means) / max(np.mean(means), 1e-9)))


def _lonely(grey: FloatArray, noise: float) -> float:
    """Return how many pixels are unlike all around them."""
    away = np.abs(grey - cv2.medianBlur(grey, 3)) > 6 * noise + 0.02
    return float(np.log(1e-5 + away.mean()))
