"""Choosing a bank's window and stride: the most accurate that keeps to a time per frame."""

import dataclasses
import time
from collections.abc import Callable

import cv2
import numpy as np
from scipy.signal import fftconvolve

from coded_aperture_ros.core.arrays import FloatArray, Shape
from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.core.workers import thread_count
from coded_aperture_ros.depth.config import VIDEO_FRAMES, DepthConfig
from coded_aperture_ros.depth.estimator import DepthEstimator
from coded_aperture_ros.likelihood.bank import FilterBank, LearnConfig, power_spectrum

# Windows that are tried, and strides as shares of a window.
_WINDOWS_PX = (48, 64, 96)
_SHARES = (1 / 6, 1 / 4, 3 / 8)
_RANK = 64
# Without higher frequencies than this, blur sizes from here on lose nothing.
_ENOUGH_FREQUENCY, _OF_BLUR_PX = 0.4, 7.0
# Two planes side by side: textures of the prior, this noise, and this many pairs of levels.
_NOISE = 0.003
_CONTRAST = 0.02
_PAIRS = 24
_SIDE_PX = 96
_TIMED_FRAMES = 9


@dataclasses.dataclass(frozen=True)
class Trial:
    """One way to do it.

    The time is the median of a frame on this machine, with spatial and temporal regularisation; the
    error, in levels, the mean on two simulated planes side by side, without regularisation.
    """

    window_px: int
    stride_px: int
    milliseconds: float
    level_error: float


def tune(
    learn: Callable[[LearnConfig], FilterBank],
    shape: Shape,
    budget_ms: float,
    config: DepthConfig | None = None,
    progress: Progress = iter,
) -> tuple[FilterBank, list[Trial]]:
    """Learn the most accurate bank that needs no more than a time per frame on this machine.

    `learn` learns the bank of a configuration, `shape` is that of the frames (rows, columns), and
    `config` says how depth will be estimated, by default as nodes do. `progress` wraps the
    iteration over windows, as ``tqdm.tqdm`` does. Returns the bank, with `stride_px` and
    `level_error`, and all that were tried.

    Raises `InputError` if none is fast enough, naming the fastest, or no window suits the frames.
    """
    config = config or DepthConfig(temporal_frames=VIDEO_FRAMES)
    banks: dict[int, FilterBank] = {}
    trials: list[Trial] = []
    for window_px in progress([size for size in _WINDOWS_PX if size <= min(shape)]):
        try:
            bank = learn(LearnConfig(window_px=window_px, rank=_RANK))
        except InputError:
            if window_px == _WINDOWS_PX[-1]:
                raise
            continue  # the largest blur does not fit
        if np.abs(bank.blur_sizes_px).min() >= _OF_BLUR_PX and bank.stack.in_pixels:
            bank = learn(
                LearnConfig(window_px=window_px, rank=_RANK, highest_frequency=_ENOUGH_FREQUENCY)
            )
        banks[window_px] = bank
        for share in _SHARES:
            stride_px = int(share * window_px)
            trials.append(
                Trial(
                    window_px,
                    stride_px,
                    round(_milliseconds(bank, shape, stride_px, config), 2),
                    round(simulated_error(bank, stride_px), 3),
                )
            )
    if not trials:
        raise InputError(
            f"frames of {shape[1]}x{shape[0]} px are smaller than the smallest window, "
            f"{_WINDOWS_PX[0]} px"
        )
    fast = [trial for trial in trials if trial.milliseconds <= budget_ms]
    if not fast:
        fastest = min(trials, key=lambda trial: trial.milliseconds)
        raise InputError(
            f"budget: nothing takes at most {budget_ms:g} ms for {shape[1]}x{shape[0]} px here; "
            f"the fastest, a window of {fastest.window_px} px every {fastest.stride_px} px, takes "
            f"{fastest.milliseconds:g} ms: allow more time, more threads or fewer levels"
        )
    best = min(fast, key=lambda trial: trial.level_error)
    bank = dataclasses.replace(
        banks[best.window_px], stride_px=best.stride_px, level_error=best.level_error
    )
    return bank, trials


def simulated_error(bank: FilterBank, stride_px: int) -> float:
    """Return the mean error, in levels, on planes of two levels side by side.

    The same planes for every bank of these levels. Some of the pixels are near the edge, where
    small windows are better, and the rest are not, where large ones are.
    """
    random = np.random.default_rng(0)
    estimator = DepthEstimator(
        bank,
        DepthConfig(
            stride_px=stride_px, regularize="none", confidence_threshold=0.0, saturation=2.0
        ),
    )
    firsts = np.linspace(0, bank.levels - 1, _PAIRS).round().astype(int)
    errors = []
    for first in firsts:
        # Where a window meets the edge must not be the same for all.
        edge = int(random.integers(_SIDE_PX // 2, 3 * _SIDE_PX // 2))
        second = (first + bank.levels // 2) % bank.levels
        left, right = (_plane(bank.stack.psfs[n], 2 * _SIDE_PX, random) for n in (first, second))
        frame = np.hstack([left[:, :edge], right[:, edge:]])
        truth = np.where(np.arange(2 * _SIDE_PX) < edge, first, second)
        level = estimator.estimate(frame).level
        unknown = np.isnan(level)
        level[unknown] = (bank.levels - 1) / 2
        errors.append(np.abs(level - truth).mean())
    estimator.close()
    return float(np.mean(errors))


def _plane(psf: FloatArray, side: int, random: np.random.Generator) -> FloatArray:
    """Return a textured plane behind one PSF, with noise."""
    size = side + len(psf) - 1
    spectrum = np.fft.rfft2(random.standard_normal((size, size)))
    spectrum *= np.sqrt(_CONTRAST * power_spectrum(2.4, (size, size)))
    sharp = 0.5 + np.fft.irfft2(spectrum, (size, size))
    noise = _NOISE * random.standard_normal((side, side))
    return np.asarray(fftconvolve(sharp, psf, mode="valid") + noise, np.float32)


def _milliseconds(bank: FilterBank, shape: Shape, stride_px: int, config: DepthConfig) -> float:
    """Return the median time of a frame, with maps of its size."""
    random = np.random.default_rng(0)
    side = max(shape)
    plane = _plane(bank.stack.psfs[bank.levels // 2], side, random)[: shape[0], : shape[1]]
    frames = [(plane + _NOISE * random.standard_normal(shape)).astype(np.float32) for _ in range(3)]
    estimator = DepthEstimator(bank, dataclasses.replace(config, stride_px=stride_px))
    before = cv2.getNumThreads()
    cv2.setNumThreads(thread_count(config.threads))
    times = []
    for number in range(_TIMED_FRAMES + 3):
        start = time.perf_counter()
        estimator.estimate(frames[number % len(frames)])
        times.append(time.perf_counter() - start)
    estimator.close()
    cv2.setNumThreads(before)
    return float(1e3 * np.median(times[3:]))
