"""The effective PSF: one continuous PSF from dots that lie differently on the pixels.

Every dot shows the same PSF, sampled at the pixels, which lie differently on each. A dot a third of
a pixel off adds samples between those of the others; together they tell the PSF at any place
(J. Anderson and I. King, 2000, for the stars of a telescope). Between samples it is predicted as
the value of least expected error, for what is known of a mask's PSF: open and closed areas with
straight edges, integrated over pixels.
"""

import dataclasses
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

# How far, in px, the mask's openings reach in the mean; the prediction hardly depends on it.
_OPENING_PX = 0.4
# Samples that a prediction is made from: more hardly help.
_SAMPLES = 400
_FARTHEST_PX = 2.0
_STEP_PX = 0.005
REACH_PX = int(_FARTHEST_PX) + 1


# A PSF that is about right: its values at whole pixels from a place, for a width.
Model = Callable[[NDArray[np.float64], int], NDArray[np.float64]]


@dataclasses.dataclass(frozen=True, eq=False)
class Samples:
    """Pictures of one PSF, each sampled at whole pixels from a place of its own.

    Attributes
    ----------
    windows : ndarray of float64, shape [N, k, k]
        Odd width; light over that of the whole PSF, without background.
    offsets : ndarray of float64, shape [N, 2]
        Where in each window, relative to the middle pixel, the PSF has its origin, in px.
    variances : ndarray of float64, shape [N]
        Of the noise of each window's pixels.
    """

    windows: NDArray[np.float64]
    offsets: NDArray[np.float64]
    variances: NDArray[np.float64]


def predict(
    samples: Samples,
    place: NDArray[np.floating],
    misplaced_px: float = 0.0,
    model: Model | None = None,
) -> tuple[NDArray[np.float64], float]:
    """Predict the PSF at whole pixels from a place beside its origin.

    Parameters
    ----------
    samples : Samples
    place : array of 2 floats
        Down and right of the origin, in px, less than 1: value [i, j] is that of the PSF at
        ``(i - middle, j - middle) + place``.
    misplaced_px : float
        Standard deviation of the errors of the offsets: they act like noise.
    model : callable, optional
        What the PSF is about: only the difference from it is predicted.

    Returns
    -------
    psf : ndarray of float64, shape [k - 2 REACH_PX, k - 2 REACH_PX]
    variance : float
        Of its values, from the samples' noise.
    """
    which, shifts, distances = _near(samples.offsets, place)
    # Where there is light at all, it varies between none and the mean that light itself sees.
    mean = samples.windows.mean(axis=0)
    signal = max(float((mean**2).sum() / mean.sum()) ** 2 / 4, 1e-30)
    noise = samples.variances[which]
    nugget = noise / signal + 2 * _bend() * misplaced_px**2 + 1e-6
    between = _covariance(distances[:, None, :] - distances[None, :, :])
    between[np.diag_indices(len(which))] += nugget
    # Weights of sum 1 keep a constant; the last unknown is their multiplier.
    system = np.ones((len(which) + 1, len(which) + 1))
    system[:-1, :-1] = between
    system[-1, -1] = 0
    weights = linalg.solve(system, np.append(_covariance(distances), 1.0), assume_a="sym")[:-1]
    windows = samples.windows
    width = windows.shape[1] - 2 * REACH_PX
    psf = np.zeros((width, width))
    if model is not None:
        windows = windows - np.stack([model(-one, windows.shape[1]) for one in samples.offsets])
        psf += model(np.asarray(place, np.float64), width)
    for weight, dot, (down, right) in zip(weights, which, shifts + REACH_PX, strict=True):
        psf += weight * windows[dot, down : down + width, right : right + width]
    return psf, float(weights**2 @ noise)


def fine_psf(samples: Samples, finer: int, misplaced_px: float) -> NDArray[np.float64]:
    """Return the PSF at steps of ``1 / finer`` px [m, m], its origin in the middle; m is odd."""
    width = samples.windows.shape[1] - 2 * REACH_PX
    fine = np.empty((width * finer, width * finer))
    for down in range(finer):
        for right in range(finer):
            place = np.array([down, right]) / finer
            fine[down::finer, right::finer] = predict(samples, place, misplaced_px)[0]
    # The rows after the last pixel would need the one beyond: cut to the same on both sides.
    return fine[: fine.shape[0] - finer + 1, : fine.shape[1] - finer + 1]


def _near(
    offsets: NDArray[np.float64], place: NDArray[np.floating]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return dot, shift in whole px and distance in px of the samples around a place."""
    farthest = float(np.clip(np.sqrt(_SAMPLES / max(len(offsets), 1)) / 2, 0.5, _FARTHEST_PX))
    steps = np.arange(-REACH_PX, REACH_PX + 1)
    shifts = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    # A pixel `shift` from the middle of a window shows the PSF at `shift - offset`.
    distances = shifts[None] - offsets[:, None] - np.asarray(place)
    which, number = np.nonzero(np.abs(distances).max(axis=2) <= farthest)
    return which, shifts[number], distances[which, number]


@cache
def _profile() -> NDArray[np.float64]:
    """Covariance along one axis at steps of `_STEP_PX`: an exponential, integrated over pixels."""
    line = np.arange(-8, 8 + _STEP_PX / 2, _STEP_PX)
    pixels = np.maximum(0, 1 - np.abs(line))
    values = np.convolve(np.exp(-np.abs(line) / _OPENING_PX), pixels, mode="same")
    middle = len(line) // 2
    return np.asarray(values[middle:] / values[middle])


@cache
def _bend() -> float:
    """Mean square of the slope along one axis, for values of variance 1."""
    number = round(0.2 / _STEP_PX)
    return float(2 * (1 - _profile()[number]) / 0.2**2)


def _covariance(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    profile = _profile()
    # Linear interpolation; numpy.interp would search for each of very many distances.
    steps = np.abs(distances) / _STEP_PX
    before = steps.astype(np.int32)
    share = steps - before
    return np.asarray((profile[before] * (1 - share) + profile[before + 1] * share).prod(axis=-1))
