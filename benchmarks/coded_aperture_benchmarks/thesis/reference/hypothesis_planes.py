"""Choice of the level by reconstruction error, the way of the methods we compare with."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from coded_aperture_benchmarks.thesis.reference.deconvolution import (
    DECONVOLVERS,
    PeriodicPicture,
    check_method,
    transfer_function,
)
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.optics import PsfStack

_LEARNING_STRIDE_PX = 8
_SWEEPS = 4
# A sweep over all levels that gains less than this share of the cost was the last.
_LEAST_GAIN = 1e-3
_SMALLEST_ERROR = 1e-30
# How far beyond the errors of all pixels a weight is put that no pixel bounds, natural log.
_BEYOND = 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class HypothesisPlanes:
    """Depth by deconvolution with the PSF of every level ("hypothesis planes").

    A picture ``g`` is deconvolved with the PSF ``h_d`` of every level ``d``, and at every pixel
    the level of least weighted reconstruction error wins, averaged over a window around it:
    ``argmin_d w_d mean |g - h_d * f_d|^2`` (thesis eq. 4.9 without its prior on depth; Levin et
    al. 2007). The weights matter: a PSF that passes little explains every picture badly, the
    right level or not. Levin et al. learn them, `with_learned_weights` does.

    Attributes
    ----------
    method : str
        One of `REFERENCE_METHODS`.
    stack : PsfStack
        L levels.
    noise : float
        Standard deviation of the noise of the pictures, intensities 0 to 1.
    weights : ndarray of float64, shape [L], optional
        > 0, ones by default.
    window_px : int
        Side of the square that errors are averaged over; odd.
    """

    method: str
    stack: PsfStack
    noise: float
    weights: NDArray[np.float64] = None  # type: ignore[assignment]
    window_px: int = 61

    def __post_init__(self) -> None:
        check_method(self.method)
        if not (np.isfinite(self.noise) and self.noise >= 0):
            raise InputError(f"noise: expected a standard deviation >= 0, got {self.noise}")
        if self.window_px < 1 or self.window_px % 2 == 0:
            raise InputError(f"window: expected an odd number of pixels, got {self.window_px}")
        weights = np.ones(len(self.stack)) if self.weights is None else self.weights
        weights = np.array(weights, dtype=np.float64)
        if weights.shape != (len(self.stack),):
            raise InputError(
                f"weights: expected one for each of the {len(self.stack)} levels, "
                f"got the shape {list(weights.shape)}"
            )
        if not (np.isfinite(weights).all() and (weights > 0).all()):
            raise InputError("weights: all must be finite and more than 0")
        weights.setflags(write=False)
        object.__setattr__(self, "weights", weights)

    def errors(self, coded: NDArray[np.float32], progress: Progress = iter) -> NDArray[np.float32]:
        """Return the locally averaged reconstruction error of every level, without weights.

        Parameters
        ----------
        coded : ndarray of float32, shape [h, w]
            Grey, linear light, 0 to 1; larger than the PSFs.
        progress : callable, optional
            Wraps the iterable of the levels, as tqdm does.

        Returns
        -------
        ndarray of float32, shape [L, h, w]
            Mean square difference, intensities squared. Only residuals at least half a PSF from
            the border count, which the world beyond the border has no part in; a pixel nearer to
            the border than half a window more has the error of the nearest window.
        """
        picture = np.asarray(coded, dtype=np.float32)
        width = self.stack.psfs.shape[1]
        if picture.ndim != 2 or min(picture.shape) <= width:
            raise InputError(
                f"coded picture: expected [h, w], both larger than the PSFs' {width} px, "
                f"got the shape {list(picture.shape)}"
            )
        if not np.isfinite(picture).all():
            raise InputError("coded picture: all values must be finite")
        deconvolve = DECONVOLVERS[self.method]
        periodic = PeriodicPicture.of(picture, width)
        errors = np.empty((len(self.stack), *picture.shape), np.float32)
        for level, psf in enumerate(progress(self.stack.psfs)):
            transfer = transfer_function(psf, periodic.extended.shape)
            sharp = deconvolve(periodic, transfer, self.noise)
            residual = periodic.cropped(periodic.spectrum - transfer * sharp)
            errors[level] = _local_mean(residual**2, self.window_px, width // 2)
        return errors

    def levels(self, coded: NDArray[np.float32], progress: Progress = iter) -> NDArray[np.intp]:
        """Return the level of least weighted error at every pixel [h, w]; see `errors`."""
        errors = self.errors(coded, progress)
        errors *= self.weights[:, None, None].astype(np.float32)
        return np.argmin(errors, axis=0)

    def with_learned_weights(
        self, coded: NDArray[np.float32], true_level: NDArray[np.integer], progress: Progress = iter
    ) -> "HypothesisPlanes":
        """Return a copy with the weights that suit a training picture best.

        They minimise the mean |level error|. As many weights as levels adapt to the textures of
        the training picture: it should show every level with several of them, and be as noisy as
        the pictures to come.

        Parameters
        ----------
        coded : ndarray of float32, shape [h, w]
            As for `errors`.
        true_level : ndarray of integer, shape [h, w]
            Level of each pixel; pixels with a negative one are left out.
        progress : callable, optional
            Wraps the iterable of the levels.
        """
        true = np.asarray(true_level)
        if true.shape != np.shape(coded):
            raise InputError(
                f"true levels: expected the coded picture's shape {list(np.shape(coded))}, "
                f"got {list(true.shape)}"
            )
        # No weight can be learned from a level that does not exist.
        if true.dtype.kind not in "iu" or true.max(initial=0) >= len(self.stack):
            raise InputError(f"true levels: expected integers less than {len(self.stack)}")
        # Neighbours share most of their windows: every few pixels say all there is.
        sparse = (slice(_LEARNING_STRIDE_PX // 2, None, _LEARNING_STRIDE_PX),) * 2
        known = true[sparse] >= 0
        if not known.any():
            raise InputError("true levels: no pixel has one")
        errors = self.errors(coded, progress)[(slice(None), *sparse)][:, known]
        weights = _learned_weights(errors.T, true[sparse][known].astype(np.int64))
        return dataclasses.replace(self, weights=weights)


def _local_mean(values: NDArray[np.float32], window_px: int, margin_px: int) -> NDArray[np.float32]:
    """Mean over windows that keep a margin to the border [h, w]; see `HypothesisPlanes.errors`."""
    height, width = values.shape
    inner = values[margin_px : height - margin_px, margin_px : width - margin_px]
    rows, columns = (min(window_px, (side - 1) // 2 * 2 + 1) for side in inner.shape)
    mean = cv2.blur(inner, (columns, rows))
    top, left = rows // 2, columns // 2
    mean = mean[top : inner.shape[0] - top, left : inner.shape[1] - left]
    return np.pad(mean, ((margin_px + top,) * 2, (margin_px + left,) * 2), mode="edge")


def _learned_weights(errors: NDArray[np.float32], true: NDArray[np.int64]) -> NDArray[np.float64]:
    """Minimise the mean |level error| over the weights, one after the other.

    Parameters
    ----------
    errors : ndarray of float32, shape [n, L]
    true : ndarray of int64, shape [n]

    Returns
    -------
    ndarray of float64, shape [L]
    """
    logs = np.log(np.maximum(errors, _SMALLEST_ERROR).astype(np.float64))
    levels = range(logs.shape[1])
    typical = np.median(logs, axis=0)
    at_truth = [
        np.median(logs[true == level, level]) if (true == level).any() else typical[level]
        for level in levels
    ]
    # The cost has many minima: start from the best of the plain guesses.
    starts = [np.zeros(len(levels)), -np.array(at_truth), -typical]
    costs = [_cost(logs + start, true) for start in starts]
    best = int(np.argmin(costs))
    weights, cost = starts[best].copy(), costs[best]
    for _ in range(_SWEEPS):
        before = cost
        for level in levels:
            weights[level], cost = _best_weight(logs, weights, level, true)
        if before - cost <= _LEAST_GAIN * before:
            break
    return np.exp(weights - weights.mean())


def _cost(weighted_logs: NDArray[np.float64], true: NDArray[np.int64]) -> float:
    return float(np.mean(np.abs(np.argmin(weighted_logs, axis=1) - true)))


def _best_weight(
    logs: NDArray[np.float64], weights: NDArray[np.float64], level: int, true: NDArray[np.int64]
) -> tuple[float, float]:
    """Minimise the cost over one level's log weight, exactly.

    A sample goes to that level if the weight is below the sample's threshold, otherwise to the
    best of the other levels: with the thresholds sorted, running sums give the cost of every
    choice. Returns the log weight and the mean |level error|.
    """
    others = logs + weights
    others[:, level] = np.inf
    runner_up = np.argmin(others, axis=1)
    thresholds = others[np.arange(len(true)), runner_up] - logs[:, level]
    without = np.abs(runner_up - true)
    gains = np.abs(level - true) - without
    order = np.argsort(-thresholds, kind="stable")
    thresholds = thresholds[order]
    costs = without.sum() + np.concatenate([[0], np.cumsum(gains[order])])
    # Between samples of equal thresholds there is no choice.
    costs[1:-1][np.diff(thresholds) == 0] = without.sum() + np.abs(gains).sum() + 1
    winners = int(np.argmin(costs))
    bounds = np.concatenate([[thresholds[0] + _BEYOND], thresholds, [thresholds[-1] - _BEYOND]])
    return float(bounds[winners : winners + 2].mean()), float(costs[winners]) / len(true)
