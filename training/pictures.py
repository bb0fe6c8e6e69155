"""What the blend learns from: random scenes as hypotheses of deblurring, and as sharp pictures.

python training/pictures.py --output DIR --shards 0 40
"""

import argparse
import dataclasses
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from costs import banks_of, recorded, seen
from scenes import FRAME_PX, drawn, mask_of
from shards import add_shard_options, compute

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
from coded_aperture_ros.optics import Mask, render_psf_stack
from coded_aperture_ros.simulation.layered import random_scene

FRAMES_PER_SHARD = 25
# Every frame is deblurred twice: by the depth that is estimated from it, and by the true depth,
# which is made worse in most frames.
DEPTHS = 2

# Kernels of the closed form; as many as the package takes for brightness.
_RANK = 10
# How often the learned decision estimates the depth, and not the semiglobal one.
_LEARNED_SHARE = 0.75
_WORSE_SHARE, _HOLES_SHARE = 0.65, 0.3
# Squares of wrong blur: their side, and about how much of the map they cover.
_SQUARE_PX, _SQUARES_COVER = 12, 0.03
# Errors without an edge, and holes, are random numbers at so many places a side, enlarged. There
# are holes where they are above a limit, in standard deviations.
_ROUGH_SIDE, _HOLES_SIDE, _HOLES_ABOVE = 24, 12, 1.2


@dataclasses.dataclass(frozen=True)
class Camera:
    """What looks at frames through one mask, on one side of the plane in focus.

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
def camera_of(mask: str, side: str, bank: int, folder: Path) -> Camera:
    """Return the camera with a mask and one of the banks, which are kept in a folder."""
    of_side = banks_of(mask, side, bank, folder)[0]
    sign = -1.0 if side == "near" else 1.0
    estimators = {
        name: DepthEstimator(of_side, DepthConfig(regularize=name))
        for name in ("learned", "semiglobal")
    }
    # Spectra do not tell the sides, pictures do.
    stack = render_psf_stack(mask_of(mask), sign * of_side.blur_sizes_px)
    return Camera(estimators, InverseHypotheses(stack, _RANK, Workers()), sign)


def list_pictures(number: int, folder: Path) -> dict[str, np.ndarray]:
    """Return frame `number` as the network is shown it, for each of the `DEPTHS`.

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
    what = drawn(number)
    if what.side == "both":
        what = dataclasses.replace(what, side="far")
    random = np.random.default_rng([21, number])
    mask = mask_of(what.mask)
    scene = random_scene(what.seed, mask, what.side, (FRAME_PX, FRAME_PX))
    light = scene.coded(_cut(mask, random))
    # What a camera does to weak texture and to dark areas cannot be undone.
    how = seen(number, what.side)
    how = dataclasses.replace(how, smoothed=0.0, eight_bits=False, gain=0.0)
    frame = recorded(light, how, number)
    camera = camera_of(what.mask, what.side, how.bank, folder)
    learned = random.random() < _LEARNED_SHARE
    estimator = camera.estimators["learned" if learned else "semiglobal"]
    true = filled_blur_map(scene.blur_size_px().astype(np.float32), frame)
    estimated = estimator.estimate(frame).blur_size_px * np.float32(camera.sign)
    sharp = pack_cells(scene.all_in_focus()[None])
    shown = [
        _shown(frame, sharp, blur if np.isfinite(blur).any() else true, camera)
        for blur in (estimated, _measured(true, random))
    ]
    return _stacked(shown)


def _cut(mask: Mask, random: np.random.Generator) -> Mask:
    """Return a mask as it is cut or printed: a little different from what the bank believes."""
    uneven = 1 + random.uniform(0, 0.05) * random.standard_normal(mask.transmission.shape)
    return Mask(mask.name, np.clip(mask.transmission * uneven, 0, 1).astype(np.float32))


def _shown(
    frame: np.ndarray, sharp: np.ndarray, blur_px: np.ndarray, camera: Camera
) -> dict[str, np.ndarray]:
    """Return what the network is shown of a frame with a blur map that may have holes."""
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


def _measured(blur_px: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return true blur sizes as if they were measured: often worse, sometimes with holes."""
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
    """Return what a morphological operator looks at: up to `reach` px away."""
    return np.ones((2 * int(reach) + 1,) * 2, np.uint8)


def _enlarged(
    side: int, shape: tuple[int, ...], random: np.random.Generator, interpolation: int
) -> np.ndarray:
    """Return normal random numbers at `side` places each way, enlarged to a shape."""
    coarse = random.standard_normal((side, side)).astype(np.float32)
    return cv2.resize(coarse, shape[::-1], interpolation=interpolation)


def _stacked(each: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.stack([one[name] for one in each]) for name in each[0]}


def pictures_shard(shard: int, folder: Path | None) -> dict[str, np.ndarray]:
    """Return all frames of a shard, stacked."""
    folder = folder or Path(tempfile.gettempdir()) / "coded_aperture_training_banks"
    numbers = range(shard * FRAMES_PER_SHARD, (shard + 1) * FRAMES_PER_SHARD)
    return _stacked([list_pictures(number, folder) for number in numbers])


def main() -> None:
    """Make the shards that are not there yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_shard_options(parser)
    args = parser.parse_args()
    # Other machines keep the banks that they learn to themselves.
    folder = None if args.scheduler else args.output / "banks"
    tasks = [
        (args.output / f"pictures_{shard:04d}.npz", lambda shard=shard: (shard, folder))
        for shard in range(*args.shards)
    ]
    modules = ("shards.py", "scenes.py", "costs.py", "pictures.py")
    compute(pictures_shard, tasks, modules, args.scheduler)


if __name__ == "__main__":
    # Workers know the functions of modules, not those of this program.
    from pictures import main

    main()
