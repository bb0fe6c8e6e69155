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
from coded_aperture_ros.depth.stages.reliability import reliability_terms
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
# Scenes, of which two frames are made each, their side, px, and the first seed: no training and no
# benchmark has these.
SCENES = 24
_SCENE_PX = 256
_FIRST_SEED = 3_000_000
# Noise of the scenes, linear light, where the camera's is not known; log-uniform.
_NOISES = (0.002, 0.02)
# Levels are rendered in so many steps.
_STEPS_PER_LEVEL = 3
# Every so many pixels of a map count: neighbours say the same.
_SPARSE = 4
# Right is an error of at most one level or, where depths are known, of this share of the depth.
_TOLERANCE = 0.05
# Penalty of the squared coefficient of the noise, which is undetermined where that is known.
_RIDGE = 1e-3


def learn_nominal_bank(
    stack: PsfStack,
    config: LearnConfig,
    prior: NaturalImagePrior,
    learned_from: str,
    progress: Progress = iter,
) -> FilterBank:
    """Bank of PSFs without sizes in px, with nominal sizes, and its own confidence if needed.

    PSFs that grow evenly are as those of a mask; too few have no nominal sizes. Both make a bank as
    `learn_bank` does.

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
    sized = with_nominal_sizes(stack)
    if not sized.nominal or grows_evenly(stack):
        return learn_bank(sized, config, prior, learned_from, progress=progress)
    if not config.window_px:
        window_px = max(config.for_blur(0.0, stack.psfs.shape[-1]).window_px, _WIDE_WINDOW_PX)
        config = dataclasses.replace(config, window_px=window_px)
    bank = learn_bank(sized, config, prior, learned_from, progress=progress)
    return dataclasses.replace(bank, reliability=measured_reliability(bank, progress))


def measured_reliability(bank: FilterBank, progress: Progress = iter) -> tuple[float, ...]:
    """Coefficients of the `reliability_terms` that make the confidence right for a bank.

    Parameters
    ----------
    bank : FilterBank
    progress : callable, optional
        Progress callback around the iteration over scenes.
    """
    plain = dataclasses.replace(bank, reliability=())
    estimator = DepthEstimator(plain, DepthConfig(confidence_threshold=0.0, check_fit=False))
    sparse = np.s_[::_SPARSE, ::_SPARSE]
    terms, right = [], []
    for seed in progress(range(SCENES)):
        for frame, level in simulated_frames(plain, seed):
            estimate = estimator.estimate(frame)
            confidence = estimate.confidence[sparse]
            known = confidence > 0
            terms.append(reliability_terms(confidence[known], estimate.noise))
            right.append(is_right(bank.stack, estimate.level[sparse], level[sparse])[known])
    estimator.close()
    return _logistic_fit(np.concatenate(terms, axis=1), np.concatenate(right))


def simulated_frames(bank: FilterBank, seed: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield frames of a scene through a bank's PSFs, and the fractional level of each pixel.

    Parameters
    ----------
    bank : FilterBank
    seed : int
        From 0 on; the scenes of banks without sizes are the first `SCENES`.
    """
    stack = bank.stack
    order = np.argsort(stack.blur_sizes_px if stack.depths_m is None else stack.depths_m)
    psfs = stack.psfs[None] if stack.channel_psfs is None else stack.channel_psfs
    random = np.random.default_rng([seed, _FIRST_SEED])
    # Every other scene is a room with nothing in it.
    size = _SCENE_PX, _SCENE_PX
    scene = random_scene(_FIRST_SEED + seed, Mask.named("disc"), shape=size, empty=bool(seed % 2))
    light = scene.all_in_focus()
    behind = scene.blur_size_px()
    behind = (behind - behind.min()) / max(float(np.ptp(behind)), 1e-6)
    # All levels, or a part of them.
    for first, last in ((0.0, 1.0), np.sort(random.random(2))):
        rank = _ranks(stack, first, last, behind)
        noise = bank.noise or float(np.exp(random.uniform(*np.log(_NOISES))))
        frame = np.empty((*light.shape, len(psfs)), np.float32)
        for channel, of_channel in enumerate(psfs):
            tint = random.uniform(0.5, 1) if len(psfs) > 1 else 1.0
            coded = tint * coded_frame(light, rank, of_channel[order])
            frame[..., channel] = coded + noise * random.standard_normal(light.shape)
        level = np.interp(rank, np.arange(len(order)), order).astype(np.float32)
        yield np.clip(frame if len(psfs) > 1 else frame[..., 0], 0, 1), level


def _ranks(stack: PsfStack, first: float, last: float, behind: FloatArray) -> FloatArray:
    """Fractional index of the level of each pixel, by depth, float32 [rows, columns].

    Pixels have all depths of a share of the range, from `first` to `last` of it, the nearest where
    `behind` is 0 and the farthest where it is 1. Known depths are in proportion to the share by
    their logarithm, and blur of a scene to the inverse depth.
    """
    last_rank = len(stack) - 1
    if stack.depths_m is None:
        return np.asarray((first + (last - first) * behind) * last_rank, np.float32)
    depths_m = np.sort(stack.depths_m)
    span = np.log(depths_m[-1] / depths_m[0])
    near, far = (1 / (depths_m[0] * np.exp(share * span)) for share in (first, last))
    inverse = near + (far - near) * behind
    return np.interp(-inverse, -1 / depths_m, np.arange(len(stack))).astype(np.float32)


def coded_frame(light: FloatArray, rank: FloatArray, psfs: FloatArray) -> FloatArray:
    """Frame of surfaces behind each other, each blurred by its PSF, float32 [rows, columns].

    The PSF of each pixel is interpolated between those of its two levels, to a third of a level;
    nearer surfaces hide those behind them.

    Parameters
    ----------
    light : ndarray, float32 [rows, columns]
        The scene, all in focus.
    rank : ndarray, float32 [rows, columns]
        Fractional index of each pixel's PSF.
    psfs : ndarray, float32 [L, k, k]
        The nearest first.
    """
    steps = np.rint(rank * _STEPS_PER_LEVEL).astype(np.intp)
    frame = np.zeros_like(light)
    covered = np.zeros_like(light)
    for step in np.unique(steps)[::-1]:
        here = (steps == step).astype(np.float32)
        index, part = divmod(int(step), _STEPS_PER_LEVEL)
        share = np.float32(part / _STEPS_PER_LEVEL)
        psf = (1 - share) * psfs[index] + share * psfs[min(index + 1, len(psfs) - 1)]
        kernel = np.ascontiguousarray(psf[::-1, ::-1])
        blurred, cover = (
            cv2.filter2D(one, -1, kernel, borderType=cv2.BORDER_REFLECT_101)
            for one in (here * light, here)
        )
        frame = (1 - cover) * frame + blurred
        covered = (1 - cover) * covered + cover
    return np.asarray(frame / np.maximum(covered, np.float32(1e-3)))


def is_right(stack: PsfStack, level: FloatArray, truth: FloatArray) -> BoolArray:
    """Where levels are right, to one level or, where depths are known, 5 % of the depth."""
    depth_m = stack.interpolate_depth(level)
    true_m = stack.interpolate_depth(truth)
    if depth_m is None or true_m is None:
        return np.asarray(np.abs(level - truth) <= 1)
    return np.asarray(np.abs(depth_m - true_m) <= _TOLERANCE * true_m)


def _logistic_fit(terms: DoubleArray, right: BoolArray) -> tuple[float, ...]:
    """Coefficients of the terms [3, n] under which `right` [n] is the likeliest."""

    def cost(coefficients: DoubleArray) -> float:
        odds = coefficients @ terms
        likelihood = np.mean(np.logaddexp(0, odds) - right * odds)
        return float(likelihood + _RIDGE * coefficients[2] ** 2)

    # Confidence never falls where the decoder's rises.
    bounds = [(-20, 20), (0.05, 10), (-5, 5)]
    found = scipy.optimize.minimize(cost, [0.0, 1.0, 0.0], bounds=bounds)
    return tuple(found.x.tolist())
