"""Simulated frames through the PSFs of a bank without sizes, and which depths of them are right."""

from collections.abc import Iterator
from functools import lru_cache

import cv2
import numpy as np

from coded_aperture_ros.core.arrays import BoolArray, FloatArray
from coded_aperture_ros.likelihood.bank import FilterBank
from coded_aperture_ros.optics import Mask, PsfStack
from coded_aperture_ros.simulation.layered import random_scene

# Scenes, of which two frames are made each, their side, px, and the first seed: no training and no
# benchmark has these.
SCENES = 24
_SCENE_PX = 256
_FIRST_SEED = 3_000_000
# Noise of the scenes, linear light, where the camera's is not known; log-uniform.
_NOISES = (0.002, 0.02)
# Levels are rendered in so many steps.
_STEPS_PER_LEVEL = 3
# Right is an error of at most one level or, where depths are known, of this share of the depth.
_TOLERANCE = 0.05


def psfs_of_channels(stack: PsfStack) -> FloatArray:
    """PSFs of every channel [C, L, k, k]; of one channel if they do not differ."""
    return stack.psfs[None] if stack.channel_psfs is None else stack.channel_psfs


def simulated_frames(
    bank: FilterBank, seed: int, psfs: FloatArray | None = None
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield frames of a scene through a bank's PSFs, and the fractional level of each pixel.

    Parameters
    ----------
    bank : FilterBank
    seed : int
        From 0 on; the scenes of banks without sizes are the first `SCENES`.
    psfs : ndarray, float32 [C, L, k, k], optional
        In place of the bank's, for frames that do not fit it: the same scene, noise and light.
    """
    stack = bank.stack
    order = np.argsort(stack.blur_sizes_px if stack.depths_m is None else stack.depths_m)
    psfs = psfs_of_channels(stack) if psfs is None else psfs
    random = np.random.default_rng([seed, _FIRST_SEED])
    # Every other scene is a room with nothing in it.
    light, behind = _scene(_FIRST_SEED + seed, _SCENE_PX, bool(seed % 2))
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


@lru_cache(maxsize=1)
def _scene(seed: int, side_px: int, empty: bool) -> tuple[FloatArray, FloatArray]:
    """Light of a scene, all in focus, and how far behind each pixel is, 0 to 1."""
    scene = random_scene(seed, Mask.named("disc"), shape=(side_px, side_px), empty=empty)
    behind = scene.blur_size_px()
    behind = (behind - behind.min()) / max(float(np.ptp(behind)), 1e-6)
    return scene.all_in_focus(), behind


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
