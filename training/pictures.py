"""Coded frames, depth of several kinds, and the sharp picture: to learn deblurring from.

python training/pictures.py --output DIR --shards 0 40
"""

import argparse
import sys

import cv2
import numpy as np
from costs import banks_of, recorded, seen
from pathlib import Path
from scenes import BLUR_STEP, FRAME_PX, LIGHT_STEP, drawn, mask_of
from shards import add_shard_options, compute

from coded_aperture_ros.core.workers import Workers
from coded_aperture_ros.deblur.blend.features import in_cells, level_and_scale, maps_in_cells
from coded_aperture_ros.deblur.blend.hypotheses import Hypotheses, sizes_of
from coded_aperture_ros.deblur.blur_map import filled_blur_map
from coded_aperture_ros.depth import DepthConfig, DepthEstimator
from coded_aperture_ros.imaging import KnownNoise, channel_noise
from coded_aperture_ros.optics import Mask, render_psf_stack
from coded_aperture_ros.simulation.layered import random_scene
from functools import lru_cache
import dataclasses

FRAMES_PER_SHARD = 25
KINDS = 2  # of depth for each frame


def wrong_patches(blur, random):
    """A few squares with another blur size."""
    blur = blur.copy()
    low, high = np.nanmin(blur), np.nanmax(blur)
    for _ in range(int(blur.size * 0.03 / 144)):
        y, x = random.integers(0, FRAME_PX - 12, 2)
        blur[y : y + 12, x : x + 12] = random.uniform(low, high)
    return blur


def degraded(blur, random):
    """True blur sizes as if measured badly."""
    kind = random.integers(6)
    if kind == 0:
        return blur
    if kind == 1:  # thin things are missed
        side = 2 * int(random.integers(1, 5)) + 1
        return cv2.morphologyEx(blur, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
    if kind == 2:
        return wrong_patches(blur, random)
    if kind == 3:  # fat foregrounds
        side = 2 * int(random.integers(1, 7)) + 1
        return cv2.erode(blur, np.ones((side, side), np.uint8))
    if kind == 4:  # edges between
        return cv2.GaussianBlur(blur, (0, 0), random.uniform(0.7, 4))
    rough = cv2.resize(random.standard_normal((24, 24)).astype(np.float32), blur.shape[::-1], interpolation=cv2.INTER_CUBIC)
    return blur * np.float32(random.normal(1, 0.02)) + rough * np.float32(random.uniform(0, 0.6))


@lru_cache(maxsize=24)
def of_camera(mask, side, index, folder):
    bank = banks_of(mask, side, index, folder)[0]
    # Spectra do not tell the sides, pictures do.
    sizes = bank.blur_sizes_px * (-1 if side == "near" else 1)
    estimators = {
        name: DepthEstimator(bank, DepthConfig(regularize=name))
        for name in ("learned", "semiglobal")
    }
    return estimators, Hypotheses(render_psf_stack(mask_of(mask), sizes), 10, Workers())


def example(number, folder):
    what = drawn(number)
    if what.side == "both":
        what = dataclasses.replace(what, side="far")
    random = np.random.default_rng([21, number])
    mask = mask_of(what.mask)
    scene = random_scene(what.seed, mask, what.side, (FRAME_PX, FRAME_PX))
    uneven = 1 + random.uniform(0, 0.05) * random.standard_normal(mask.transmission.shape)
    light = scene.coded(Mask(mask.name, np.clip(mask.transmission * uneven, 0, 1).astype(np.float32)))
    sharp, blur = scene.all_in_focus(), scene.blur_size_px()
    how = seen(number, what.side)
    how = dataclasses.replace(how, smoothed=0.0, eight_bits=False, gain=0.0)
    frame = recorded(light, how, number)
    estimators, hypotheses = of_camera(what.mask, what.side, how.bank, folder)
    sign = np.float32(-1 if what.side == "near" else 1)  # the bank's levels are of one side
    true = np.where(np.isfinite(blur) , blur, np.nan).astype(np.float32)
    regularize = "learned" if random.random() < 0.75 else "semiglobal"
    estimate = estimators[regularize].estimate(frame)
    noise = float(channel_noise(frame, KnownNoise()))
    parts = []
    true_filled = filled_blur_map(true, frame)
    for kind in range(KINDS):
        if kind == 0:
            given = estimate.blur_size_px * sign
        else:
            given = degraded(true_filled, random) if random.random() < 0.65 else true_filled
            if random.random() < 0.3:
                hole = cv2.resize(random.standard_normal((12, 12)).astype(np.float32), given.shape[::-1]) > 1.2
                given = np.where(hole, np.nan, given)
        if not np.isfinite(given).any():
            given = true_filled
        known = np.isfinite(given)
        full = filled_blur_map(given, frame)
        found = hypotheses.of(frame, hypotheses.steps(full), noise)
        cells = in_cells(found)
        mean, scale = level_and_scale(cells[-16:], noise)
        parts.append((
            ((cells - mean) / scale).astype(np.float16),
            maps_in_cells(sizes_of(full), known, scale, noise).astype(np.float16),
            ((in_cells(sharp[None]) - mean) / scale).astype(np.float16),
            scale.astype(np.float32),
            np.float32(noise),
        ))
    names = ("cells", "maps", "sharp", "scale", "noise")
    return dict(zip(names, map(np.stack, zip(*parts))))


def shard_of(shard, folder):
    made = [example(n, folder) for n in range(shard * FRAMES_PER_SHARD, (shard + 1) * FRAMES_PER_SHARD)]
    return {name: np.stack([one[name] for one in made]) for name in made[0]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    add_shard_options(parser)
    args = parser.parse_args()
    folder = args.output / "banks"
    tasks = [
        (args.output / f"pictures_{shard:04d}.npz", lambda shard=shard: (shard, folder))
        for shard in range(*args.shards)
    ]
    compute(shard_of, tasks, ("shards.py", "scenes.py", "costs.py", "pictures.py"), args.scheduler)


if __name__ == "__main__":
    from pictures import main

    main()
