"""What the blend learns from: random scenes as hypotheses of deblurring, and as sharp pictures."""

import dataclasses
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from costs import mask_banks, recorded, recording_plan
from scenes import FRAME_PX, mask_named, scene_plan, uneven_mask
from shards import Arrays, Data, stack

from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.blend.features import (
    CELL_PX,
    cell_maps,
    mean_and_contrast,
    pack_cells,
)
from coded_aperture_ros.deblur.blend.hypotheses import InverseHypotheses, hypothesis_blur_sizes
from coded_aperture_ros.deblur.blur_map import filled_blur_map
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.frames import KnownNoise, channel_noise
from coded_aperture_ros.optics import render_psf_stack
from coded_aperture_ros.simulation.layered import random_scene

FRAMES_PER_SHARD = 25
# Every frame is deblurred twice: by the depth that is estimated from it, and by the true depth,
# which is made worse in most frames.
DEPTHS = 2

# Kernels of the closed form; as many as the package takes for brightness.
_RANK = 10
# How often the learned decision estimates the depth, and not the semiglobal one.
_LEARNED_SHARE = 0.75
_WORSE_SHARE = 0.65
_HOLES_SHARE = 0.3
# Squares of wrong blur: their side, and about how much of the map they cover.
_SQUARE_PX = 12
_SQUARES_COVER = 0.03
# Errors without an edge, and holes, are random numbers at so many places a side, enlarged. There
# are holes where they are above a limit, in standard deviations.
_ROUGH_SIDE = 24
_HOLES_SIDE = 12
_HOLES_ABOVE = 1.2


@dataclasses.dataclass(frozen=True)
class Camera:
    """Estimators and inverse filters of one mask, on one side of the plane in focus.

    Attributes
    ----------
    estimators : dict of str to DepthEstimator
        By how they decide: `DepthConfig.regularize`.
    hypotheses : InverseHypotheses
    sign : float
        Of the camera's blur sizes: -1 if they are of what is nearer than the plane in focus.
    """

    estimators: dict[str, DepthEstimator]
    hypotheses: InverseHypotheses
    sign: float


@lru_cache(maxsize=24)
def mask_camera(mask: str, side: str, index: int, folder: Path) -> Camera:
    """Camera with a mask and one of its banks, which are kept in a folder."""
    bank = mask_banks(mask, side, index, folder).bank
    sign = -1.0 if side == "near" else 1.0
    estimators = {
        name: DepthEstimator(bank, DepthConfig(regularize=name))
        for name in ("learned", "semiglobal")
    }
    # Spectra do not tell the sides, pictures do.
    psfs = render_psf_stack(mask_named(mask), sign * bank.blur_sizes_px)
    return Camera(estimators, InverseHypotheses(psfs, _RANK, Workers()), sign)


def picture_arrays(number: int, folder: Path) -> Arrays:
    """Frame `number` as the network is given it, for each of the `DEPTHS`.

    All but the noise is in cells; `mean_and_contrast` says what mean is taken away from them, and
    what they are divided by.

    Returns
    -------
    dict of str to ndarray
        cells : float16 [DEPTHS, hypotheses * 16, rows, columns]
        maps : float16 [DEPTHS, MAPS, rows, columns]
        sharp : float16 [DEPTHS, 16, rows, columns], the truth
        scale : float32 [DEPTHS, rows, columns], linear light
        noise : float32 [DEPTHS], its standard deviation, linear light
    """
    plan = scene_plan(number)
    if plan.side == "both":
        plan = dataclasses.replace(plan, side="far")
    random = np.random.default_rng([21, number])
    mask = mask_named(plan.mask)
    scene = random_scene(plan.seed, mask, plan.side, (FRAME_PX, FRAME_PX))
    light = scene.coded(uneven_mask(mask, random.uniform(0, 0.05), random))
    # What a camera does to weak texture and to dark areas cannot be undone.
    how = recording_plan(number, plan.side)
    how = dataclasses.replace(how, smoothed=0.0, eight_bits=False, gain=0.0)
    frame = recorded(light, how, number)
    camera = mask_camera(plan.mask, plan.side, how.bank, folder)
    learned = random.random() < _LEARNED_SHARE
    estimator = camera.estimators["learned" if learned else "semiglobal"]
    true = filled_blur_map(scene.blur_size_px().astype(np.float32), frame)
    estimated = estimator.estimate(frame).blur_size_px * np.float32(camera.sign)
    sharp = pack_cells(scene.all_in_focus()[None])
    maps = (estimated, measured_blur(true, random))
    return stack(
        [
            _network_inputs(frame, sharp, blur if np.isfinite(blur).any() else true, camera)
            for blur in maps
        ]
    )


def _network_inputs(
    frame: np.ndarray, sharp: np.ndarray, blur_px: np.ndarray, camera: Camera
) -> Arrays:
    """What the network is given of a frame with a blur map that may have holes."""
    noise = float(channel_noise(frame, KnownNoise()))
    sizes = hypothesis_blur_sizes(filled_blur_map(blur_px, frame))
    steps = np.stack([camera.hypotheses.table_steps(each) for each in sizes])
    cells = pack_cells(camera.hypotheses.compute(frame, steps, noise))
    # The last hypothesis is the frame.
    mean, scale = mean_and_contrast(cells[-(CELL_PX**2) :], noise)
    maps = cell_maps(sizes, np.isfinite(blur_px), scale, noise)
    return {
        "cells": ((cells - mean) / scale).astype(np.float16),
        "maps": maps.astype(np.float16),
        "sharp": ((sharp - mean) / scale).astype(np.float16),
        "scale": scale.astype(np.float32),
        "noise": np.float32(noise),
    }


def measured_blur(blur_px: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """True blur sizes as if they were measured: often worse, sometimes with holes."""
    if random.random() < _WORSE_SHARE:
        blur_px = _ERRORS[random.integers(len(_ERRORS))](blur_px, random)
    if random.random() < _HOLES_SHARE:
        holes = _enlarged(_HOLES_SIDE, blur_px.shape, random, cv2.INTER_LINEAR) > _HOLES_ABOVE
        blur_px = np.where(holes, np.nan, blur_px)
    return blur_px


def _none(blur_px: np.ndarray, random: np.random.Generator) -> np.ndarray:
    return blur_px


def _without_thin(blur_px: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Miss what is thin and near."""
    return cv2.morphologyEx(blur_px, cv2.MORPH_CLOSE, _square(random.integers(1, 5)))


def _wrong_squares(blur_px: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Take any of the scene's blur sizes in a few squares."""
    found = blur_px.copy()
    low, high = np.nanmin(blur_px), np.nanmax(blur_px)
    for _ in range(int(blur_px.size * _SQUARES_COVER / _SQUARE_PX**2)):
        y, x = random.integers(0, np.subtract(blur_px.shape, _SQUARE_PX))
        found[y : y + _SQUARE_PX, x : x + _SQUARE_PX] = random.uniform(low, high)
    return found


def _fat_foregrounds(blur_px: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Let what is near reach beyond its edges."""
    return cv2.erode(blur_px, _square(random.integers(1, 7)))


def _smooth_edges(blur_px: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Take what is between both sides at depth edges."""
    return cv2.GaussianBlur(blur_px, (0, 0), random.uniform(0.7, 4))


def _wavy(blur_px: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Add errors that change slowly, and a wrong unit."""
    rough = _enlarged(_ROUGH_SIDE, blur_px.shape, random, cv2.INTER_CUBIC)
    return blur_px * np.float32(random.normal(1, 0.02)) + rough * np.float32(random.uniform(0, 0.6))


# One of these is drawn; their order is that of the stored shards.
_ERRORS: tuple[Callable[[np.ndarray, np.random.Generator], np.ndarray], ...] = (
    _none,
    _without_thin,
    _wrong_squares,
    _fat_foregrounds,
    _smooth_edges,
    _wavy,
)


def _square(reach: int) -> np.ndarray:
    """Window of a morphological operator: up to `reach` px away."""
    return np.ones((2 * int(reach) + 1,) * 2, np.uint8)


def _enlarged(
    side: int, shape: tuple[int, ...], random: np.random.Generator, interpolation: int
) -> np.ndarray:
    """Normal random numbers at `side` places each way, enlarged to a shape."""
    coarse = random.standard_normal((side, side)).astype(np.float32)
    return cv2.resize(coarse, shape[::-1], interpolation=interpolation)


def _compute_shard(shard: int, _: dict[str, Arrays], folder: Path) -> Arrays:
    numbers = range(shard * FRAMES_PER_SHARD, (shard + 1) * FRAMES_PER_SHARD)
    return stack([picture_arrays(number, folder) for number in numbers])


PICTURES = Data(
    "pictures", _compute_shard, modules=("measured", "scenes", "banks", "costs", "pictures")
)
