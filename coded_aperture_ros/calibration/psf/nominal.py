"""Banks of PSFs without sizes: nominal sizes, and a confidence measured with the PSFs themselves.

The confidence of the decoders is right for masks, on which they were fitted. Other PSFs, such as
those of phase masks, may tell less apart, which costs do not show. So simulated scenes are rendered
with the PSFs, and the confidence becomes the share of depths that are right there.
"""

import dataclasses
from collections.abc import Iterator

import cv2
import numpy as np
import scipy.optimize

from coded_aperture_ros.core.arrays import BoolArray, DoubleArray, FloatArray
from coded_aperture_ros.core.progress import Progress
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.likelihood.bank import (
    FilterBank,
    LearnConfig,
    NaturalImagePrior,
    learn_bank,
)
from coded_aperture_ros.optics import Mask, PsfStack
from coded_aperture_ros.optics.nominal import grows_evenly, with_nominal_sizes
from coded_aperture_ros.simulation.layered import random_scene

# Side of the patches for PSFs that do not grow as those of a mask, px: they tell less apart, so
# that more of the frame has to.
_WIDE_WINDOW_PX = 64
# Scenes that are rendered, their side, px, and their first seed: no training or benchmark has them.
SCENES = 16
_SCENE_PX = 256
_FIRST_SEED = 3_000_000
# Noise of the scenes, linear light, where the camera's is not known; log-uniform.
_NOISES = (0.002, 0.02)
# Every so many pixels of a map count: neighbours say the same.
_SPARSE = 4
# Right is an error of at most one level or, where depths are known, of this share of the depth.
_TOLERANCE = 0.05
# Confidences nearer to 0 and 1 count as these.
_SURE = 1e-4


def learn_nominal_bank(
    stack: PsfStack,
    config: LearnConfig,
    prior: NaturalImagePrior,
    learned_from: str,
    progress: Progress = iter,
) -> FilterBank:
    """Bank of PSFs without sizes in px, with nominal sizes and a measured confidence.

    Parameters
    ----------
    stack : PsfStack
        Its sizes are not in px.
    config, prior, learned_from, progress
        See `learn_bank`.

    Raises
    ------
    InputError
        As `learn_bank`.
    """
    if not config.window_px and not grows_evenly(stack):
        widest = stack.psfs.shape[-1]
        config = dataclasses.replace(config.for_blur(widest_psf_px=widest), noise=config.noise)
        window_px = max(config.window_px, _WIDE_WINDOW_PX)
        config = dataclasses.replace(config, window_px=window_px)
    bank = learn_bank(with_nominal_sizes(stack), config, prior, learned_from, progress=progress)
    return dataclasses.replace(bank, reliability=measured_reliability(bank, progress))


def measured_reliability(bank: FilterBank, progress: Progress = iter) -> tuple[float, float]:
    """Offset and factor of the log-odds of the confidence that make it right for a bank.

    Parameters
    ----------
    bank : FilterBank
    progress : callable, optional
        Progress callback around the iteration over scenes.
    """
    plain = dataclasses.replace(bank, reliability=())
    estimator = DepthEstimator(plain, DepthConfig(confidence_threshold=0.0, check_fit=False))
    odds, right = [], []
    for frame, level in progress(_scenes(plain)):
        estimate = estimator.estimate(frame)
        sparse = np.s_[::_SPARSE, ::_SPARSE]
        confidence = estimate.confidence[sparse].astype(np.float64)
        known = confidence > 0
        certain = np.clip(confidence[known], _SURE, 1 - _SURE)
        odds.append(np.log(certain / (1 - certain)))
        right.append(_is_right(bank.stack, estimate.level[sparse], level[sparse])[known])
    estimator.close()
    return _logistic_fit(np.concatenate(odds), np.concatenate(right))


def _scenes(bank: FilterBank) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield frames through a bank's PSFs, with noise, and the fractional level of each pixel."""
    stack = bank.stack
    order = np.argsort(stack.blur_sizes_px if stack.depths_m is None else stack.depths_m)
    for seed in range(SCENES):
        random = np.random.default_rng([seed, _FIRST_SEED])
        scene = random_scene(_FIRST_SEED + seed, Mask.named("disc"), shape=(_SCENE_PX, _SCENE_PX))
        behind = scene.blur_size_px()
        behind = (behind - behind.min()) / max(float(np.ptp(behind)), 1e-6)
        # Every other scene has all levels, the others a part of them.
        first, last = (0.0, 1.0) if seed % 2 else np.sort(random.random(2))
        rank = (first + (last - first) * behind) * (len(stack) - 1)
        light = scene.all_in_focus()
        psfs = stack.psfs[None] if stack.channel_psfs is None else stack.channel_psfs
        tints = random.uniform(0.5, 1, len(psfs)) if len(psfs) > 1 else np.ones(1)
        noise = bank.noise or float(np.exp(random.uniform(*np.log(_NOISES))))
        channels = [
            np.clip(coded + noise * random.standard_normal(coded.shape), 0, 1)
            for coded in (
                tint * coded_frame(light, rank, of_channel[order])
                for tint, of_channel in zip(tints, psfs, strict=True)
            )
        ]
        frame = np.stack(channels, axis=-1) if len(channels) > 1 else channels[0]
        yield (
            frame.astype(np.float32),
            np.interp(rank, np.arange(len(order)), order).astype(np.float32),
        )


def coded_frame(light: FloatArray, rank: FloatArray, psfs: FloatArray) -> FloatArray:
    """Frame of surfaces behind each other, each blurred by its PSF, float32 [rows, columns].

    The PSF of each pixel is that of the nearest level; nearer surfaces hide those behind them.

    Parameters
    ----------
    light : ndarray, float32 [rows, columns]
        The scene, all in focus.
    rank : ndarray, float32 [rows, columns]
        Fractional index of each pixel's PSF.
    psfs : ndarray, float32 [L, k, k]
        The nearest first.
    """
    nearest = np.rint(rank).astype(np.intp)
    frame = np.zeros_like(light)
    covered = np.zeros_like(light)
    for index in range(len(psfs) - 1, -1, -1):
        here = (nearest == index).astype(np.float32)
        if not here.any():
            continue
        kernel = np.ascontiguousarray(psfs[index, ::-1, ::-1])
        blurred, share = (
            cv2.filter2D(part, -1, kernel, borderType=cv2.BORDER_REFLECT_101)
            for part in (here * light, here)
        )
        frame = (1 - share) * frame + blurred
        covered = (1 - share) * covered + share
    return np.asarray(frame / np.maximum(covered, np.float32(1e-3)))


def _is_right(stack: PsfStack, level: FloatArray, truth: FloatArray) -> BoolArray:
    """Where levels are right, to one level or 5 % of the depth."""
    depth_m = stack.interpolate_depth(level)
    true_m = stack.interpolate_depth(truth)
    if depth_m is None or true_m is None:
        return np.asarray(np.abs(level - truth) <= 1)
    return np.asarray(np.abs(depth_m - true_m) <= _TOLERANCE * true_m)


def _logistic_fit(odds: DoubleArray, right: BoolArray) -> tuple[float, float]:
    """Offset and factor of log-odds [n] under which `right` [n] is the likeliest."""

    def cost(coefficients: DoubleArray) -> float:
        measured = coefficients[0] + coefficients[1] * odds
        return float(np.mean(np.logaddexp(0, measured) - right * measured))

    # Confidence never falls where the decoder's rises.
    found = scipy.optimize.minimize(cost, [0.0, 1.0], bounds=[(-10, 10), (0.05, 10)])
    offset, factor = found.x
    return float(offset), float(factor)
